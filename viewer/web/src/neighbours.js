// Section "Neighbours" of FORMAT.md.

const FARTHEST = 2 ** 44 - 1;

/** The up to four neighbours of each point of a block, nearest first, and their weights. */
export class Neighbours {
  /** @param {Int32Array[]} places positions of the points, on three axes */
  constructor([xs, ys, zs]) {
    const count = xs.length;
    this.places = new Int32Array(4 * count);
    this.weights = new Uint16Array(4 * count);
    this.counts = new Uint8Array(count);
    this.totals = new Uint16Array(count);
    /** The two nearest of each point; `count` if missing. */
    this.nearest = new Int32Array(2 * count).fill(count);
    const distances = new Float64Array(5);
    const near = new Int32Array(5);
    for (let i = 0; i < count; i++) {
      let found = 0;
      for (let j = i - 1; j >= 0 && j >= i - 8; j--) {
        const [x, y, z] = [xs[i] - xs[j], ys[i] - ys[j], zs[i] - zs[j]];
        const distance = x * x + y * y + z * z;
        let k = found;
        // Later points are inserted first, so they stay before others at the same distance.
        for (; k > 0 && distance < distances[k - 1]; k--) {
          distances[k] = distances[k - 1];
          near[k] = near[k - 1];
        }
        distances[k] = distance;
        near[k] = j;
        found = Math.min(found + 1, 4);
      }
      const first = Math.min(distances[0], FARTHEST);
      let total = 0;
      for (let k = 0; k < found; k++) {
        const far = Math.min(distances[k], FARTHEST);
        const weight = Math.floor((256 * (first + 1)) / (far + first + 1));
        this.places[4 * i + k] = near[k];
        if (k < 2) this.nearest[2 * i + k] = near[k];
        this.weights[4 * i + k] = weight;
        total += weight;
      }
      this.counts[i] = found;
      this.totals[i] = total;
    }
  }

  /** The prediction for point i from its neighbours' values; 0 without neighbours. */
  predict(i, values) {
    const total = this.totals[i];
    if (total === 0) return 0;
    let sum = 0;
    for (let k = 4 * i; k < 4 * i + this.counts[i]; k++) {
      sum += this.weights[k] * values[this.places[k]];
    }
    return Math.floor((2 * sum + total) / (2 * total));
  }

  /** The sum of weighted differences of the neighbours' values from a prediction. */
  spread(i, values, guess) {
    let sum = 0;
    for (let k = 4 * i; k < 4 * i + this.counts[i]; k++) {
      sum += this.weights[k] * Math.abs(values[this.places[k]] - guess);
    }
    return sum;
  }
}
