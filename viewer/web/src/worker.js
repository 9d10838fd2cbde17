// A worker that decodes blocks for `WorkerPool`.
import { Blocks } from './blocks.js';

let blocks = null;

self.onmessage = ({ data }) => {
  try {
    if (data.setup) {
      blocks = new Blocks(data.setup);
      return;
    }
    const planes = blocks.decode(data);
    self.postMessage({ id: data.id, planes }, [planes.buffer]);
  } catch (error) {
    const { name, message, where } = error;
    self.postMessage({ id: data.id, error: { name, message, where } });
  }
};
