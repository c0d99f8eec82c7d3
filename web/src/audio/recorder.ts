/** Longest recording in seconds. */
export const LONGEST = 60;
const RATE = 44_100;

/** A recording in progress. */
export interface Recording {
  /** Ends it; `song` then resolves. */
  stop(): void;
  song: Promise<File>;
}

/** Whether this page may use a microphone: browsers want HTTPS or localhost. */
export function canRecord(): boolean {
  return 'mediaDevices' in navigator && typeof MediaRecorder !== 'undefined';
}

/** Records up to a minute; `elapsed` is called with the seconds so far. */
export async function record(elapsed: (seconds: number) => void): Promise<Recording> {
  // Processing for speech would eat the music.
  const audio = { echoCancellation: false, noiseSuppression: false, autoGainControl: false };
  const stream = await navigator.mediaDevices.getUserMedia({ audio });
  const recorder = new MediaRecorder(stream);
  const parts: Blob[] = [];
  const started = performance.now();
  const timer = setInterval(() => {
    const seconds = (performance.now() - started) / 1000;
    elapsed(seconds);
    if (seconds >= LONGEST) stop();
  }, 200);
  const stop = () => {
    if (recorder.state !== 'inactive') recorder.stop();
  };
  const song = new Promise<File>((resolve, reject) => {
    recorder.ondataavailable = (event) => parts.push(event.data);
    recorder.onerror = () => reject(new Error('The recording failed.'));
    recorder.onstop = () => {
      clearInterval(timer);
      for (const track of stream.getTracks()) track.stop();
      wav(new Blob(parts, { type: recorder.mimeType })).then(resolve, reject);
    };
  });
  recorder.start();
  return { stop, song };
}

/** Rewrites a recording as WAV: recorders leave out the length, without which nobody can seek. */
async function wav(recording: Blob): Promise<File> {
  const context = new OfflineAudioContext(1, 1, RATE);
  const sound = await context.decodeAudioData(await recording.arrayBuffer());
  const bytes = new Uint8Array(44 + sound.length * 2);
  const view = new DataView(bytes.buffer);
  const text = (at: number, value: string) => {
    for (let i = 0; i < value.length; i++) view.setUint8(at + i, value.charCodeAt(i));
  };
  text(0, 'RIFF');
  view.setUint32(4, 36 + sound.length * 2, true);
  text(8, 'WAVEfmt ');
  view.setUint32(16, 16, true);
  view.setUint16(20, 1, true);
  view.setUint16(22, 1, true);
  view.setUint32(24, RATE, true);
  view.setUint32(28, RATE * 2, true);
  view.setUint16(32, 2, true);
  view.setUint16(34, 16, true);
  text(36, 'data');
  view.setUint32(40, sound.length * 2, true);
  const channels = Array.from({ length: sound.numberOfChannels }, (_, i) =>
    sound.getChannelData(i),
  );
  for (let i = 0; i < sound.length; i++) {
    const mean = channels.reduce((sum, channel) => sum + channel[i], 0) / channels.length;
    view.setInt16(44 + i * 2, Math.round(Math.min(Math.max(mean, -1), 1) * 32767), true);
  }
  return new File([bytes], 'recording.wav', { type: 'audio/wav' });
}
