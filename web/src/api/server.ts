import { jsonLines } from './lines';
import type { Codebooks, ErrorBody, Info, Options, StreamEvent } from './types';

/** An answer of the server that is not a success, in the server's words. */
export class ServerFault extends Error {
  constructor(
    message: string,
    readonly kind: string,
    readonly requestId: string,
    readonly status: number,
    readonly retryAfter: number | null,
  ) {
    super(message);
  }
}

/** The server that the page came from. */
export class Server {
  /** API key, kept in memory only. */
  key = '';
  private books: Promise<Codebooks> | null = null;

  /** Address of a route, relative to the page: a proxy may serve it under a path. */
  address(route: string): string {
    return new URL(route, document.baseURI).href;
  }

  async info(): Promise<Info> {
    return (await this.fetch('info', {})).json() as Promise<Info>;
  }

  /** The codebooks of the model, which are asked for once. */
  codes(): Promise<Codebooks> {
    const ask = async () => (await this.fetch('codes', {})).json() as Promise<Codebooks>;
    this.books ??= ask().catch((error: unknown) => {
      this.books = null;
      throw error;
    });
    return this.books;
  }

  /** Generates a dance, of given codes without a song; yields its events while it is made. */
  async *stream(
    song: File | null,
    options: Options,
    signal: AbortSignal,
  ): AsyncGenerator<StreamEvent> {
    const form = formOf(song, { ...options, include: 'rotations', encoding: 'base64' });
    const headers = { accept: 'application/x-ndjson' };
    const answer = await this.fetch('generate/stream', {
      method: 'POST',
      body: form,
      headers,
      signal,
    });
    if (!answer.body) throw new Error('The browser gives no access to the answer.');
    try {
      yield* jsonLines<StreamEvent>(answer.body);
    } catch (error) {
      // What browsers throw when the network fails says nothing to people.
      if (signal.aborted || !(error instanceof TypeError)) throw error;
      throw interrupted();
    }
  }

  /** Generates a dance as a file of `format`. */
  async file(song: File, options: Options, format: string): Promise<Blob> {
    const form = formOf(song, { ...options, format });
    const answer = await this.fetch('generate', { method: 'POST', body: form });
    return answer.blob();
  }

  private async fetch(route: string, init: RequestInit): Promise<Response> {
    const headers = new Headers(init.headers);
    if (this.key !== '') headers.set('x-api-key', this.key);
    let answer: Response;
    try {
      answer = await fetch(this.address(route), { ...init, headers });
    } catch (error) {
      if (init.signal?.aborted) throw error;
      throw new ServerFault('The server cannot be reached.', 'unreachable', '', 0, null);
    }
    if (!answer.ok) throw await faultOf(answer);
    return answer;
  }
}

/** The error of a stream that ends too early. */
export function interrupted(): ServerFault {
  const text = 'The connection ended before the dance did.';
  return new ServerFault(text, 'interrupted', '', 0, null);
}

function formOf(song: File | null, options: Options): FormData {
  const form = new FormData();
  // Options first: the server checks them before it reads the song.
  for (const [name, value] of Object.entries(options)) form.append(name, value);
  // Given codes need no song.
  if (song && options.codes === undefined) form.append('file', song, song.name);
  return form;
}

async function faultOf(answer: Response): Promise<ServerFault> {
  const body = (await answer.json().catch(() => null)) as ErrorBody | null;
  const retryAfter = Number(answer.headers.get('retry-after') ?? NaN);
  return new ServerFault(
    body?.error ?? `The server answered ${answer.status} ${answer.statusText}.`,
    body?.error_type ?? 'unknown',
    body?.request_id ?? '',
    answer.status,
    Number.isFinite(retryAfter) ? retryAfter : null,
  );
}

/** The command that generates the same file without the page; codes need no song. */
export function curl(address: string, song: string, options: Options, format: string): string {
  const stem = song.replace(/\.[^.]*$/, '');
  const parts = Object.entries({ ...options, format }).map(([name, value]) => `${name}=${value}`);
  const file = `file=@"${song.replace(/(["\\])/g, '\\$1')}"`;
  const forms = options.codes === undefined ? [file, ...parts] : parts;
  const form = forms.map((part) => `-F ${quote(part)}`).join(' ');
  return `curl --fail-with-body ${form} ${quote(address)} -o ${quote(`${stem}.${format}`)}`;
}

/** Quotes for a POSIX shell where that is needed. */
function quote(text: string): string {
  return /^[\w@%+=:,./-]+$/.test(text) ? text : `'${text.replaceAll("'", `'\\''`)}'`;
}
