// What can go wrong: every exception of the decoder is of one of these classes.

/** Base of all errors of this package; `where` names the part of the file, if one is known. */
export class EgsError extends Error {
  constructor(message, where = '') {
    super(where ? `${where}: ${message}` : message);
    this.name = new.target.name;
    this.where = where;
  }
}

/** The file breaks its format: it is damaged, cut off, or no .egs file. */
export class CorruptError extends EgsError {}

/** The file is of a later version, or needs what this decoder does not have. */
export class UnsupportedError extends EgsError {}

/** The scene is larger than `maxBytes`. */
export class TooLargeError extends EgsError {}

/** The bytes could not be had: the server or the connection failed. */
export class SourceError extends EgsError {}

/** A worker could not be created, or failed. */
export class WorkerError extends EgsError {}

/** Throw CorruptError unless a condition holds. */
export function check(condition, where, message) {
  if (!condition) throw new CorruptError(message, where);
}
