// Runs the decoder's worker in a worker of Node.
import { parentPort } from 'node:worker_threads';

globalThis.self = { postMessage: (message, transfer) => parentPort.postMessage(message, transfer) };
await import('../../viewer/web/src/worker.js');
parentPort.on('message', (data) => self.onmessage({ data }));
