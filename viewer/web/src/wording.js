// Numbers with their nouns, for messages.

const GROUPED = new Intl.NumberFormat('en-US');

/** A number and its noun: "1 Gaussian", "1,234 Gaussians". */
export const counted = (number, noun) =>
  `${GROUPED.format(number)} ${noun}${number === 1 ? '' : 's'}`;
