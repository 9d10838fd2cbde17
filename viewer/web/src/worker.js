// A worker that decodes blocks for `WorkerPool`.
import { Files } from './blocks.js';

let files = null;

self.onmessage = ({ data }) => {
  try {
    if (data.setups) {
      files = new Files(data.setups);
      return;
    }
    if (data.release !== undefined) {
      files.release(data.release);
      return;
    }
    const planes = files.decode(data);
    self.postMessage(
      { id: data.id, planes },
      [planes].flat().map(({ buffer }) => buffer),
    );
  } catch (error) {
    const { name, message, where } = error;
    self.postMessage({ id: data.id, error: { name, message, where } });
  }
};
