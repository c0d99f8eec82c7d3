// Puts a dance on any Humanoid, whatever its proportions, bone axes and rest pose (T or A).

using System;
using System.Collections.Generic;
using UnityEngine;

namespace Bailando
{
    public sealed class HumanoidRetarget
    {
        // The server's joints and Unity's bones; where a rig lacks one, its children follow anyway.
        private static readonly (string joint, HumanBodyBones bone, string towards)[] Map =
        {
            ("pelvis", HumanBodyBones.Hips, null),
            ("spine1", HumanBodyBones.Spine, null),
            ("spine2", HumanBodyBones.Chest, null),
            ("spine3", HumanBodyBones.UpperChest, null),
            ("neck", HumanBodyBones.Neck, null),
            ("head", HumanBodyBones.Head, null),
            ("l_hip", HumanBodyBones.LeftUpperLeg, "l_knee"),
            ("l_knee", HumanBodyBones.LeftLowerLeg, "l_ankle"),
            ("l_ankle", HumanBodyBones.LeftFoot, "l_foot"),
            ("l_foot", HumanBodyBones.LeftToes, null),
            ("r_hip", HumanBodyBones.RightUpperLeg, "r_knee"),
            ("r_knee", HumanBodyBones.RightLowerLeg, "r_ankle"),
            ("r_ankle", HumanBodyBones.RightFoot, "r_foot"),
            ("r_foot", HumanBodyBones.RightToes, null),
            ("l_collar", HumanBodyBones.LeftShoulder, null),
            ("l_shoulder", HumanBodyBones.LeftUpperArm, "l_elbow"),
            ("l_elbow", HumanBodyBones.LeftLowerArm, "l_wrist"),
            ("l_wrist", HumanBodyBones.LeftHand, null),
            ("r_collar", HumanBodyBones.RightShoulder, null),
            ("r_shoulder", HumanBodyBones.RightUpperArm, "r_elbow"),
            ("r_elbow", HumanBodyBones.RightLowerArm, "r_wrist"),
            ("r_wrist", HumanBodyBones.RightHand, null),
        };
        // Above the floor when the dancer stands: the ball of the foot.
        private const float BallHeight = 0.015f;

        private struct Bone
        {
            public Transform Transform;
            public int Joint;
            // From the dancer's rotation in the world to this bone's: its own rest, and the way from
            // its rest direction to the dancer's.
            public Quaternion Rest;
        }

        private readonly Dance dance;
        private readonly Transform character;
        private readonly Transform hips;
        private readonly List<Bone> bones = new List<Bone>();
        private readonly Quaternion[] local;
        private readonly Quaternion[] world;
        private readonly float scale;
        private readonly float hipsHeight;
        private readonly float dancerHeight;

        /// <summary>Call while the character is in its rest pose: before an Animator has moved it.
        /// </summary>
        public HumanoidRetarget(Animator animator, Dance dance)
        {
            this.dance = dance;
            character = animator.transform;
            hips = animator.GetBoneTransform(HumanBodyBones.Hips);
            local = new Quaternion[dance.Joints.Length];
            world = new Quaternion[dance.Joints.Length];
            var upright = Quaternion.Inverse(character.rotation);
            foreach (var pair in Map)
            {
                var transform = animator.GetBoneTransform(pair.bone);
                if (transform == null)
                    continue;
                var rest = upright * transform.rotation;
                var end = Find(animator, pair.towards);
                if (end != null)
                {
                    var own = upright * (end.position - transform.position);
                    var dancers = Offset(pair.towards);
                    if (pair.joint.EndsWith("ankle"))
                        own.y = dancers.y = 0; // soles stay flat: the heading alone
                    rest = Quaternion.FromToRotation(own, dancers) * rest;
                }
                bones.Add(new Bone { Transform = transform, Joint = Joint(pair.joint), Rest = rest });
            }
            scale = Leg(animator) / (Offset("l_knee").magnitude + Offset("l_ankle").magnitude);
            hipsHeight = character.InverseTransformPoint(hips.position).y;
            dancerHeight = BallHeight - Offset("l_hip").y - Offset("l_knee").y - Offset("l_ankle").y
                - Offset("l_foot").y;
        }

        /// <summary>Poses the character as at a time in seconds. Call it in LateUpdate.</summary>
        public void Apply(float seconds)
        {
            Vector3 place;
            if (!dance.Sample(seconds, local, out place))
                return;
            for (var joint = 0; joint < local.Length; joint++) // parents come first
            {
                var parent = dance.Parents[joint];
                world[joint] = parent < 0 ? local[joint] : world[parent] * local[joint];
            }
            var height = hipsHeight + scale * (place.y - dancerHeight);
            hips.position =
                character.TransformPoint(new Vector3(scale * place.x, height, scale * place.z));
            foreach (var bone in bones)
                bone.Transform.rotation = character.rotation * world[bone.Joint] * bone.Rest;
        }

        private int Joint(string name)
        {
            return Array.IndexOf(dance.Joints, name);
        }

        private Vector3 Offset(string name)
        {
            return dance.Offsets[Joint(name)];
        }

        private static Transform Find(Animator animator, string joint)
        {
            foreach (var pair in Map)
                if (pair.joint == joint)
                    return animator.GetBoneTransform(pair.bone);
            return null;
        }

        // In the character's own units, whatever the scale of its object.
        private float Leg(Animator animator)
        {
            var hip = Place(animator, HumanBodyBones.LeftUpperLeg);
            var knee = Place(animator, HumanBodyBones.LeftLowerLeg);
            var ankle = Place(animator, HumanBodyBones.LeftFoot);
            return (knee - hip).magnitude + (ankle - knee).magnitude;
        }

        private Vector3 Place(Animator animator, HumanBodyBones bone)
        {
            return character.InverseTransformPoint(animator.GetBoneTransform(bone).position);
        }
    }
}
