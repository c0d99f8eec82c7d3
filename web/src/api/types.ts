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
  model: { name: string; licence: string; skeleton: SkeletonJson; energy?: boolean };
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

/** Little-endian float32 in base64, nested lists, or what these come to. */
export type Numbers = string | Float32Array | number[][][] | number[][];

export interface FramesEvent {
  event: 'frames';
  first: number;
  count: number;
  /** `[count][joints][3]`. */
  positions: Numbers;
  /** `[count][joints][4]`, x y z w. */
  rotations: Numbers;
  /** `[count][3]`. */
  root: Numbers;
}

/** Pose codes of both halves of the body, a pair for every 8 frames at 60 a second. */
export interface Codes {
  upper: number[];
  lower: number[];
}

/** Counts of a code: how often it was used, and other codes with their numbers. */
export interface CodeUses {
  uses: number;
  next: [number, number][];
  beside: [number, number][];
}

export interface Codebooks {
  upper: number;
  lower: number;
  start_codes: [number, number][];
  suppressed_codes: Codes;
  /** What the training did with each code, where the model says it. */
  memory?: { upper: CodeUses[]; lower: CodeUses[] };
}

export interface DoneEvent {
  event: 'done';
  frames: number;
  codes: Codes;
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
