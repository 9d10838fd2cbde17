// All exceptions of the decoder.

/** Base of all errors of this package; `where` names the part of the file, if one is known. */
export class EgsError extends Error {
  constructor(message, where = '') {
    super(where ? `${where}: ${message}` : message);
    this.name = new.target.name;
    this.where = where;
  }
}

/** The file violates the format: it is damaged, truncated, or not an .egs file. */
export class CorruptError extends EgsError {}

/** The file is of a later version, or needs an unsupported feature. */
export class UnsupportedError extends EgsError {}

/** The scene is larger than `maxBytes`. */
export class TooLargeError extends EgsError {}

/** The bytes could not be read: the server or the connection failed. */
export class SourceError extends EgsError {}

/** A worker could not be created, or failed. */
export class WorkerError extends EgsError {}

/** Throw CorruptError if a condition is false. */
export function check(condition, where, message) {
  if (!condition) throw new CorruptError(message, where);
}
