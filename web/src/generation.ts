import { interrupted, type Server, ServerFault } from './api/server';
import type { Dancer } from './dancer';
import { Dance } from './motion/dance';

/** What a generation reports. */
export interface Reports {
  /** A dancer's length and music are known. */
  started(dancer: Dancer): void;
  /** More frames have arrived. */
  arrived(dancer: Dancer): void;
}

/** Generates the dances of all `dancers` at the same time; fails with the first that fails. */
export async function generate(
  server: Server,
  song: File | null,
  dancers: Dancer[],
  signal: AbortSignal,
  reports: Reports,
): Promise<void> {
  const results = await Promise.allSettled(
    dancers.map((dancer) => one(server, song, dancer, signal, reports)),
  );
  for (const result of results) if (result.status === 'rejected') throw result.reason;
}

async function one(
  server: Server,
  song: File | null,
  dancer: Dancer,
  signal: AbortSignal,
  reports: Reports,
): Promise<void> {
  try {
    for await (const event of server.stream(song, dancer.options, signal)) {
      if (event.event === 'start') {
        dancer.dance = new Dance(event);
        dancer.state = 'streaming';
        dancer.warnings = event.warnings ?? [];
        reports.started(dancer);
      } else if (event.event === 'frames') {
        dancer.dance?.append(event);
        reports.arrived(dancer);
      } else if (event.event === 'error') {
        throw new ServerFault(event.error, event.error_type, event.request_id, 500, null);
      } else if (event.event === 'done') {
        dancer.state = 'done';
        if (dancer.dance) dancer.dance.codes = event.codes;
      }
    }
    if (dancer.state !== 'done') throw interrupted();
    reports.arrived(dancer);
  } catch (error) {
    dancer.state = 'failed';
    throw error;
  }
}
