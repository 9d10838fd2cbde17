// Types of the decoder; see index.js and README.md for their meaning.

export type Source =
  ArrayBuffer | ArrayBufferView | Blob | Response | ReadableStream<Uint8Array> | string | URL;

export type Point = [x: number, y: number, z: number];
export type Degree = 0 | 1 | 2 | 3;

/** Worker options shared by `decode` and `open`. */
export interface Workers {
  workers?: number;
  createWorker?: () => Worker;
  signal?: AbortSignal;
}

export interface Part {
  block: number;
  first: number;
  count: number;
  degree: number;
}

export interface DecodeOptions extends Workers {
  shDegree?: Degree;
  box?: [low: Point, high: Point];
  onBlock?: (scene: Scene, part: Part) => void;
  onDamage?: (block: number, error: CorruptError) => void;
  onProgress?: (bytes: number, of: number) => void;
  maxBytes?: number;
  extra?: boolean;
}

export function decode(source: Source, options?: DecodeOptions): Promise<Scene>;

/** Facts about the scene of a file. */
export interface Facts {
  readonly degree: number;
  readonly profile: string;
  readonly coordinates: string | null;
  readonly antialiased: boolean;
  readonly bytes: Record<string, number>;
}

export class Scene implements Facts {
  private constructor();
  readonly count: number;
  readonly degree: number;
  readonly coefficients: number;
  readonly profile: string;
  readonly coordinates: string | null;
  readonly antialiased: boolean;
  readonly bytes: Record<string, number>;
  readonly comments: string[];
  readonly positions: Float32Array;
  readonly fDc: Float32Array;
  readonly fRest: Float32Array;
  readonly opacity: Float32Array;
  readonly logScale: Float32Array;
  readonly rotation: Float32Array;
  readonly properties: string[];
  property(name: string): Float32Array;
  move(changes: Changes): void;
}

/** A camera, in the file's axes; the rows of `rotation` point right, down, forward. */
export interface View {
  width: number;
  height: number;
  fx: number;
  fy: number;
  cx: number;
  cy: number;
  rotation: [right: Point, down: Point, forward: Point];
  position: Point;
}

export interface Level {
  readonly count: number;
  readonly blocks: number;
  readonly blockSize: number;
  readonly boxes: { centres: [low: Point, high: Point]; reach: [low: Point, high: Point] }[];
  readonly errors?: Float64Array;
}

export interface BlocksOptions {
  shDegree?: Degree;
  onBlock?: (scene: Scene, part: Part & { level: number }) => void;
  signal?: AbortSignal;
}

export interface EgsFile extends Facts {
  readonly levels: Level[];
  readonly size: number;
  readonly fetched: number;
  select(view: View, options?: { budget?: number; tolerance?: number }): number[][];
  decode(level: number, blocks: number[], options?: BlocksOptions): Promise<Scene>;
  close(): void;
}

export function open(source: Source, options?: Workers): Promise<EgsFile>;

/** What changes from one frame to the next, for `scene.move`. */
export interface Changes {
  readonly blocks: { first: number; parts: (Int32Array | Float32Array)[] }[];
}

/** A key frame and the frames after it, to `end`. */
export interface Group {
  readonly first: number;
  readonly end: number;
  readonly frame: number;
  readonly scene: Scene;
  next(): Promise<Changes>;
  close(): void;
}

export interface SequenceOptions extends Workers {
  maxBytes?: number;
}

export interface Sequence extends Facts {
  readonly count: number;
  readonly fps: number;
  readonly names: string[];
  readonly keys: number[];
  readonly size: number;
  readonly fetched: number;
  frame(number: number): Promise<Scene>;
  groupOf(frame: number): number;
  group(number: number): Promise<Group>;
  fetch(group: number): Promise<Uint8Array>;
  close(): void;
}

export function openSequence(source: Source, options?: SequenceOptions): Promise<Sequence>;

export class EgsError extends Error {
  readonly where: string;
}
export class CorruptError extends EgsError {}
export class UnsupportedError extends EgsError {}
export class TooLargeError extends EgsError {}
export class SourceError extends EgsError {}
export class WorkerError extends EgsError {}
