/** What the server sends; fields that a server may lack are optional. */

export interface SkeletonJson {
  joints: string[];
  /** Number of each joint's parent; -1 for the root. */
  parents: number[];
  /** Offset of each joint from its parent in metres; y up, facing +z, left at +x. */
  offsets: [number, number, number][];
}

export interface Music {
  tempo_bpm: number;
  beats_s: number[];
  downbeats_s?: number[];
  metre?: number;
}

export interface OptionInfo {
  name: string;
  description: string;
  accepts: string;
  default: string;
}

export interface Info {
  version: string;
  model: { name: string; licence: string; skeleton: SkeletonJson };
  options: OptionInfo[];
  formats: { name: string; content_type: string }[];
  audio: string[];
  styles?: (string | { name: string })[];
  limits: Record<string, number | null>;
}

export interface StartEvent {
  event: 'start';
  seed: number;
  fps: number;
  frames: number;
  skeleton: SkeletonJson;
  music?: Music;
  style?: string;
  warnings?: string[];
}

export interface FramesEvent {
  event: 'frames';
  first: number;
  count: number;
  /** Little-endian float32 in base64: `[count][joints][3]`. */
  positions: string;
  /** `[count][joints][4]`, x y z w. */
  rotations: string;
  /** `[count][3]`. */
  root: string;
}

export interface DoneEvent {
  event: 'done';
  frames: number;
  warnings?: string[];
}

export interface ErrorEvent extends ErrorBody {
  event: 'error';
}

export interface ErrorBody {
  error: string;
  error_type: string;
  request_id: string;
}

export type StreamEvent = StartEvent | FramesEvent | DoneEvent | ErrorEvent;

/** Options of a generation by their names in the API. */
export type Options = Record<string, string>;
