// Put this on a character with an Animator whose avatar is Humanoid and whose controller is empty (it
// would move the character, too), name a song in StreamingAssets, and press Play. The song plays
// through the AudioSource, and the dance follows its clock.

using System;
using System.Collections.Generic;
using System.IO;
using System.Threading;
using UnityEngine;

namespace Bailando
{
    [RequireComponent(typeof(Animator), typeof(AudioSource))]
    public sealed class BailandoDancer : MonoBehaviour
    {
        public string server = "http://127.0.0.1:8080";
        [Tooltip("A file in Assets/StreamingAssets")]
        public string song = "song.mp3";
        [Tooltip("The same song, imported as an AudioClip")]
        public AudioClip clip;
        public int seed = 7;
        [Tooltip("Seconds of dance to have before the song begins")]
        public float ahead = 1;

        private readonly CancellationTokenSource cancel = new CancellationTokenSource();
        private readonly Dance dance = new Dance();
        private HumanoidRetarget retarget;
        private AudioSource sound;

        private async void Start()
        {
            sound = GetComponent<AudioSource>();
            sound.clip = clip;
            var path = Path.Combine(Application.streamingAssetsPath, song);
            var options = new Dictionary<string, string> { ["seed"] = seed.ToString() };
            try
            {
                await new BailandoClient(server).Stream(path, dance, options, cancel.Token);
            }
            catch (Exception error)
            {
                // A stream that is cancelled ends with an exception, too.
                if (!cancel.IsCancellationRequested)
                    Debug.LogError("bailando: " + error.Message);
            }
        }

        private void LateUpdate()
        {
            if (dance.Joints == null)
                return;
            if (retarget == null)
                retarget = new HumanoidRetarget(GetComponent<Animator>(), dance);
            if (!sound.isPlaying && sound.time == 0 && dance.Available >= ahead)
                sound.Play();
            retarget.Apply(sound.time);
        }

        private void OnDestroy()
        {
            cancel.Cancel();
        }
    }
}
