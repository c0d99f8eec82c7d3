// A dance that grows while it is streamed, in Unity's coordinates: left-handed, y up, metres. The
// server's are right-handed with the left side at +x, so x is mirrored.

using System;
using System.Collections.Generic;
using Newtonsoft.Json.Linq;
using UnityEngine;

namespace Bailando
{
    public sealed class Dance
    {
        private readonly object gate = new object();
        private readonly List<Quaternion> rotations = new List<Quaternion>();
        private readonly List<Vector3> root = new List<Vector3>();

        /// <summary>Null until the first event has come.</summary>
        public volatile string[] Joints;
        public int[] Parents { get; private set; }
        /// <summary>From parent to child in the rest pose, in which no joint is rotated.</summary>
        public Vector3[] Offsets { get; private set; }
        public int FramesPerSecond { get; private set; }
        public int Frames { get; private set; }
        /// <summary>Seconds of the music's beats.</summary>
        public double[] Beats { get; private set; }
        /// <summary>To continue from, in the clip that follows.</summary>
        public string Tail { get; private set; }

        /// <summary>Seconds that have arrived.</summary>
        public float Available
        {
            get { lock (gate) return root.Count / (float)Math.Max(1, FramesPerSecond); }
        }

        /// <summary>Reads one line of the stream; any thread.</summary>
        public void Read(string line)
        {
            var json = JObject.Parse(line);
            switch ((string)json["event"])
            {
                case "start":
                    Begin(json);
                    break;
                case "frames":
                    Append(Floats(json["rotations"]), Floats(json["root"]));
                    break;
                case "done":
                    Tail = (string)json["tail"];
                    break;
                case "error":
                    throw BailandoClient.Refusal(line);
            }
        }

        /// <summary>Local rotations of all joints and the root's place at a time in seconds, between
        /// frames as well. False while nothing has arrived.</summary>
        public bool Sample(float seconds, Quaternion[] local, out Vector3 place)
        {
            place = Vector3.zero;
            lock (gate)
            {
                if (root.Count == 0)
                    return false;
                var at = Mathf.Clamp(seconds * FramesPerSecond, 0, root.Count - 1);
                var first = (int)at;
                var second = Math.Min(first + 1, root.Count - 1);
                var part = at - first;
                place = Vector3.Lerp(root[first], root[second], part);
                for (var joint = 0; joint < local.Length; joint++)
                    local[joint] = Quaternion.Slerp(
                        rotations[first * local.Length + joint],
                        rotations[second * local.Length + joint], part);
                return true;
            }
        }

        private void Begin(JObject start)
        {
            var skeleton = start["skeleton"];
            FramesPerSecond = (int)start["fps"];
            Frames = (int)start["frames"];
            Parents = skeleton["parents"].ToObject<int[]>();
            var offsets = skeleton["offsets"].ToObject<float[][]>();
            Offsets = Array.ConvertAll(offsets, o => new Vector3(-o[0], o[1], o[2]));
            var music = start["music"] as JObject;
            Beats = music == null ? new double[0] : music["beats_s"].ToObject<double[]>();
            Joints = skeleton["joints"].ToObject<string[]>();
        }

        private void Append(float[] turns, float[] places)
        {
            lock (gate)
            {
                for (var i = 0; i < turns.Length; i += 4)
                    rotations.Add(new Quaternion(turns[i], -turns[i + 1], -turns[i + 2], turns[i + 3]));
                for (var i = 0; i < places.Length; i += 3)
                    root.Add(new Vector3(-places[i], places[i + 1], places[i + 2]));
            }
        }

        private static float[] Floats(JToken base64)
        {
            var bytes = Convert.FromBase64String((string)base64);
            var floats = new float[bytes.Length / 4];
            Buffer.BlockCopy(bytes, 0, floats, 0, bytes.Length);
            return floats;
        }
    }
}
