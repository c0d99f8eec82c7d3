/** Yields the JSON objects of a body in lines (NDJSON), each as soon as its line is complete. */
export async function* jsonLines<T>(body: ReadableStream<Uint8Array>): AsyncGenerator<T> {
  const reader = body.getReader();
  const decoder = new TextDecoder();
  // Parts of a long line are joined once.
  let parts: string[] = [];
  try {
    for (;;) {
      const { done, value } = await reader.read();
      const text = done ? decoder.decode() : decoder.decode(value, { stream: true });
      const lines = text.split('\n');
      for (const line of lines.slice(0, -1)) {
        const whole = parts.join('') + line;
        parts = [];
        if (whole.trim() !== '') yield JSON.parse(whole) as T;
      }
      parts.push(lines[lines.length - 1] ?? '');
      if (done) break;
    }
    const rest = parts.join('');
    if (rest.trim() !== '') yield JSON.parse(rest) as T;
  } finally {
    // Whoever stops reading early ends the request, too.
    await reader.cancel().catch(() => undefined);
  }
}

/** Decodes base64 of little-endian float32. */
export function floats(base64: string): Float32Array {
  const text = atob(base64);
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  return new Float32Array(bytes.buffer, 0, bytes.length >> 2);
}
