// Types of embed.js: a page of `gs-codec share` as a part of another page.

export type Show = 'a' | 'b' | 'wipe' | 'error';
export type Up = 'cameras' | '-y' | 'y' | '-z' | 'z' | '-x' | 'x';
export type Background = 'black' | 'grey' | 'white';

/** What a page shows, as in its address. */
export interface ViewerState {
  /** Number of the view. */
  view: number;
  /** Eye, target, and the direction that is up in the picture. */
  camera: [...eye: Vector, ...target: Vector, ...up: Vector];
  /** One of two scenes, or both; undefined if the page has one. */
  show?: Show;
  /** Place of the line of a wipe, 0 to 1. */
  wipe: number;
  degree: 0 | 1 | 2 | 3;
  up: Up;
  background: Background;
  /** Whether the picture turns slowly; never where the system asks for reduced motion. */
  turn: boolean;
  /** Whether it tours the views or a camera path; as with `turn`. */
  tour: boolean;
  /** Number of the open annotation, from 1 on; 0 for none. */
  note: number;
  /** Whether only the picture is shown. */
  bare: boolean;
  /** Dark or light; an empty text for what the system asks for. */
  theme: 'dark' | 'light' | '';
  /** Frame of a paused sequence. */
  frame?: number;
}

type Vector = [x: number, y: number, z: number];

export interface ViewerOptions {
  /** The page; by default index.html in the folder of embed.js. */
  page?: string | URL;
  /** What it shows first, and in which language; by default in one of the browser's. */
  state?: Partial<ViewerState> & { lang?: 'en' | 'de' | 'fr' | 'zh' | 'ja' };
  /** Name of the frame for screen readers. */
  title?: string;
  /** Called when it shows something else: at most once a frame, also while the camera moves. */
  onChange?: (state: ViewerState) => void;
  /** Called with each message that the page shows; an empty text clears the last one. */
  onMessage?: (text: string, isError: boolean) => void;
}

/** Facts about a loaded page. */
export interface Facts {
  scenes: { name: string; count?: number; degree?: number; profile?: string }[];
  /** Names of the views. */
  views: string[];
  shows: Show[];
  ups: Up[];
  backgrounds: Background[];
  /** Messages about what could not be loaded. */
  errors: string[];
}

export interface EmbeddedViewer {
  readonly element: HTMLIFrameElement;
  /** Resolves once everything is loaded; rejects if the page does not answer. */
  readonly ready: Promise<Facts>;
  /** What is shown; undefined until the page has answered. */
  readonly state?: ViewerState;
  /** Change what is shown. Rejects, and changes nothing, if a value is not possible. */
  set(state: Partial<ViewerState>): Promise<ViewerState>;
  /** The picture as a PNG, in full resolution. */
  picture(): Promise<Blob>;
  /** Remove the frame; calls without an answer reject. */
  close(): void;
}

export function createViewer(element: HTMLElement, options?: ViewerOptions): EmbeddedViewer;
