/** Peaks a second of song. */
const RATE = 100;
/** Samples a second that are enough for a picture. */
const SAMPLE_RATE = 8000;

/** Loudest samples of a song, `RATE` a second. */
export interface Waveform {
  rate: number;
  peaks: Float32Array;
  seconds: number;
}

/** Measures the peaks of a song; `null` where the browser cannot decode it. */
export async function waveform(song: Blob): Promise<Waveform | null> {
  try {
    // Decoding to a low rate keeps ten minutes of song at a few megabytes.
    const context = new OfflineAudioContext(1, 1, SAMPLE_RATE);
    const sound = await context.decodeAudioData(await song.arrayBuffer());
    const step = Math.round(SAMPLE_RATE / RATE);
    const peaks = new Float32Array(Math.ceil(sound.length / step));
    for (let channel = 0; channel < sound.numberOfChannels; channel++) {
      const samples = sound.getChannelData(channel);
      for (let i = 0; i < samples.length; i++) {
        const at = Math.floor(i / step);
        peaks[at] = Math.max(peaks[at], Math.abs(samples[i]));
      }
    }
    return { rate: SAMPLE_RATE / step, peaks, seconds: sound.duration };
  } catch {
    return null;
  }
}
