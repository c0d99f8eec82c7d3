// Streams a dance from a server onto a made-up Humanoid and compares its limbs with the positions
// that the server says itself.
//
// Usage: Check.exe SERVER SONG

using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Net.Http;
using System.Threading;
using Bailando;
using Newtonsoft.Json.Linq;
using UnityEngine;
using Bones = UnityEngine.HumanBodyBones;

internal static class Check
{
    private const float MostDegrees = 1;
    private const float MostSink = 0.05f;

    private static readonly (Bones bone, Bones end, string joint, string towards)[] Limbs =
    {
        (Bones.LeftUpperLeg, Bones.LeftLowerLeg, "l_hip", "l_knee"),
        (Bones.LeftLowerLeg, Bones.LeftFoot, "l_knee", "l_ankle"),
        (Bones.RightUpperLeg, Bones.RightLowerLeg, "r_hip", "r_knee"),
        (Bones.RightLowerLeg, Bones.RightFoot, "r_knee", "r_ankle"),
        (Bones.LeftUpperArm, Bones.LeftLowerArm, "l_shoulder", "l_elbow"),
        (Bones.LeftLowerArm, Bones.LeftHand, "l_elbow", "l_wrist"),
        (Bones.RightUpperArm, Bones.RightLowerArm, "r_shoulder", "r_elbow"),
        (Bones.RightLowerArm, Bones.RightHand, "r_elbow", "r_wrist"),
    };

    private static int Main(string[] args)
    {
        var dance = new Dance();
        var options = new Dictionary<string, string> { ["duration_s"] = "4", ["seed"] = "7" };
        new BailandoClient(args[0]).Stream(args[1], dance, options, CancellationToken.None).Wait();
        var animator = Figure(1.9f);
        var retarget = new HumanoidRetarget(animator, dance);
        var expected = Positions(args[0], args[1]);
        var lowest = float.MaxValue;
        float worst = 0;
        for (var frame = 0; frame < dance.Frames; frame += 3)
        {
            retarget.Apply(frame / (float)dance.FramesPerSecond);
            foreach (var limb in Limbs)
            {
                var seen = animator.bones[limb.end].position - animator.bones[limb.bone].position;
                var from = expected[frame][Array.IndexOf(dance.Joints, limb.joint)];
                var to = expected[frame][Array.IndexOf(dance.Joints, limb.towards)];
                // Unity is left-handed.
                var should = new Vector3(from[0] - to[0], to[1] - from[1], to[2] - from[2]);
                var turned = animator.transform.rotation * should;
                var cosine = Vector3.Dot(seen.normalized, turned.normalized);
                worst = Math.Max(worst, (float)(Math.Acos(Math.Min(1, cosine)) * 180 / Math.PI));
            }
            foreach (var toe in new[] { Bones.LeftToes, Bones.RightToes })
                lowest = Math.Min(lowest, animator.bones[toe].position.y);
        }
        var refused = Refused(args[0], args[1]);
        Console.WriteLine(
            "{0} frames, limbs within {1:0.00} degrees, balls at least {2:0.000} m high",
            dance.Frames, worst, lowest);
        return worst < MostDegrees && lowest > -MostSink && lowest < MostSink && refused ? 0 : 1;
    }

    private static bool Refused(string server, string song)
    {
        var wrong = new Dictionary<string, string> { ["fps"] = "17" };
        try
        {
            new BailandoClient(server).Stream(song, new Dance(), wrong, CancellationToken.None).Wait();
            return false;
        }
        catch (AggregateException error) when (error.InnerException is BailandoException)
        {
            Console.WriteLine("refused: " + error.InnerException.Message);
            return true;
        }
    }

    /// Frames x joints x 3, as the same stream gives them.
    private static List<float[][]> Positions(string server, string song)
    {
        var url = server + "/generate/stream?duration_s=4&seed=7";
        using (var http = new HttpClient())
        {
            http.DefaultRequestHeaders.Accept.ParseAdd("application/x-ndjson");
            var answer = http.PostAsync(url, new StreamContent(File.OpenRead(song))).Result;
            var lines = answer.Content.ReadAsStringAsync().Result.Split('\n');
            var frames = lines.Where(line => line.Contains("\"frames\"")).Select(JObject.Parse)
                .Where(json => json["positions"] != null);
            return frames.SelectMany(json => json["positions"].ToObject<float[][][]>()).ToList();
        }
    }

    /// An A-pose with odd bone axes, turned away from the world's axes. The left is at -x.
    private static Animator Figure(float height)
    {
        var animator = new Animator();
        animator.transform.localRotation = new Quaternion(0, 0.6f, 0, 0.8f);
        var h = height;
        Action<Bones, Bones?, float, float, float> add = (bone, parent, x, y, z) =>
        {
            var above = parent == null ? animator.transform : animator.bones[parent.Value];
            var transform = new Transform { parent = above };
            transform.rotation = animator.transform.rotation * new Quaternion(0.5f, -0.5f, 0.5f, 0.5f);
            transform.position = animator.transform.TransformPoint(new Vector3(x * h, y * h, z * h));
            animator.bones[bone] = transform;
        };
        add(Bones.Hips, null, 0, 0.53f, 0);
        add(Bones.Spine, Bones.Hips, 0, 0.58f, 0);
        add(Bones.Chest, Bones.Spine, 0, 0.65f, 0);
        add(Bones.Neck, Bones.Chest, 0, 0.83f, 0);
        add(Bones.Head, Bones.Neck, 0, 0.88f, 0);
        foreach (var left in new[] { true, false })
        {
            var s = left ? -1 : 1;
            var (upper, lower, foot, toes) = left
                ? (Bones.LeftUpperLeg, Bones.LeftLowerLeg, Bones.LeftFoot, Bones.LeftToes)
                : (Bones.RightUpperLeg, Bones.RightLowerLeg, Bones.RightFoot, Bones.RightToes);
            add(upper, Bones.Hips, s * 0.05f, 0.5f, 0);
            add(lower, upper, s * 0.05f, 0.27f, 0.01f);
            add(foot, lower, s * 0.05f, 0.04f, 0);
            add(toes, foot, s * 0.05f, 0.01f, 0.08f);
            var (arm, forearm, hand) = left
                ? (Bones.LeftUpperArm, Bones.LeftLowerArm, Bones.LeftHand)
                : (Bones.RightUpperArm, Bones.RightLowerArm, Bones.RightHand);
            add(arm, Bones.Chest, s * 0.1f, 0.8f, 0);
            add(forearm, arm, s * 0.23f, 0.7f, 0);
            add(hand, forearm, s * 0.35f, 0.6f, 0);
        }
        return animator;
    }
}
