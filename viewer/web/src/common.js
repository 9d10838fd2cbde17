// What the blocks of a file share.
import { Lattice } from './lattice.js';
import { Channels } from './paper.js';

/** What the blocks of a file share, from a setup as in `Blocks`; it is checked. */
export function commonOf({ content, degree, hasBasis, isPaper }) {
  if (isPaper) return new Channels(content, degree);
  const lattice = new Lattice(content, degree);
  if (hasBasis) lattice.checkBasis();
  return lattice;
}
