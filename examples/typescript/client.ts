// A client of a bailando server for browsers and Node 20: `fetch`, no dependencies.

export interface StartEvent {
  event: 'start';
  seed: number;
  fps: number;
  frames: number;
  skeleton: { joints: string[]; parents: number[]; offsets: [number, number, number][] };
  music?: { tempo_bpm: number; beats_s: number[]; downbeats_s: number[] };
}

export interface FramesEvent {
  event: 'frames';
  /** Number of the first frame in this event. */
  first: number;
  count: number;
  /** Metres, y up: count x joints x 3. */
  positions: Float32Array;
  /** With `include: 'rotations'`: local quaternions x y z w, count x joints x 4. */
  rotations?: Float32Array;
  /** With `include: 'rotations'`: metres, count x 3. */
  root?: Float32Array;
}

export interface DoneEvent {
  event: 'done';
  frames: number;
  /** `continue_from` of the clip that follows. */
  tail: string;
}

export type DanceEvent = StartEvent | FramesEvent | DoneEvent;
export type Options = Record<string, string | number | boolean>;

/** An answer that is no dance, in the server's words. */
export class BailandoError extends Error {
  constructor(
    message: string,
    readonly kind: string,
    readonly requestId?: string,
    readonly retryAfter?: number,
  ) {
    super(message);
  }
}

export class Bailando {
  constructor(
    readonly url = 'http://127.0.0.1:8080',
    readonly key?: string,
  ) {}

  /** A dance as a file: `format` is bvh, glb, vrma, fbx, vmd, npz or json. */
  async generate(song: Blob, format: string, options: Options = {}): Promise<Blob> {
    return (await this.post('/generate', song, { ...options, format })).blob();
  }

  /** The events of a dance while it is made. Leaving the loop, or `signal`, cancels it. */
  async *stream(song: Blob, options: Options = {}, signal?: AbortSignal): AsyncGenerator<DanceEvent> {
    const packed = { encoding: 'base64', ...options };
    const answer = await this.post('/generate/stream', song, packed, signal);
    for await (const line of lines(answer.body!)) {
      const event = JSON.parse(line);
      if (event.event === 'error') {
        throw new BailandoError(event.error, event.error_type, event.request_id);
      }
      for (const name of ['positions', 'rotations', 'root']) {
        if (typeof event[name] === 'string') event[name] = floats(event[name]);
      }
      yield event;
    }
  }

  private async post(path: string, song: Blob, options: Options, signal?: AbortSignal) {
    const query = new URLSearchParams(Object.entries(options).map(([k, v]) => [k, String(v)]));
    const headers: Record<string, string> = { 'content-type': 'audio/*' };
    headers.accept = path.endsWith('/stream') ? 'application/x-ndjson' : '*/*';
    if (this.key) headers.authorization = `Bearer ${this.key}`;
    const request = { method: 'POST', body: song, headers, signal: signal ?? null };
    const answer = await fetch(`${this.url}${path}?${query}`, request);
    if (answer.ok) return answer;
    const { error, error_type, request_id } = await answer.json();
    const wait = answer.headers.get('retry-after');
    throw new BailandoError(error, error_type, request_id, wait ? Number(wait) : undefined);
  }
}

async function* lines(body: ReadableStream<Uint8Array>): AsyncGenerator<string> {
  const reader = body.getReader();
  const decoder = new TextDecoder();
  let rest = '';
  try {
    for (;;) {
      const { value, done } = await reader.read();
      if (done) return;
      const parts = (rest + decoder.decode(value, { stream: true })).split('\n');
      rest = parts.pop()!;
      yield* parts;
    }
  } finally {
    // Where the caller leaves early, the server stops as well.
    await reader.cancel();
  }
}

function floats(text: string): Float32Array {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return new Float32Array(bytes.buffer);
}
