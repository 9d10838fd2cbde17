// A stand-in for a headset with WebXR: two eyes, 6 cm apart, and a stick. `headset.step()` shows a
// picture, whose pixels `headset.pixels()` returns; `headset.matrix` is the head's pose.
(() => {
  const SIZE = [150, 200];
  const column = (x) => [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, x, 0, 0, 1];
  const times = (a, b) =>
    Array.from({ length: 16 }, (_, k) =>
      [0, 1, 2, 3].reduce((sum, i) => sum + a[4 * i + (k % 4)] * b[4 * (k >> 2) + i], 0),
    );
  // Focal lengths of 120 and 130 pixels, and a middle at (80, 90) and (70, 90).
  const projection = (aside) =>
    [1.6, 0, 0, 0, 0, 1.3, 0, 0, -aside / 15, -0.1, -1, -1, 0, 0, -0.1, 0];
  let gl, layer, asked;

  class Session extends EventTarget {
    inputSources = [];
    renderState = {};
    updateRenderState(state) {
      Object.assign(this.renderState, state);
    }
    async requestReferenceSpace(kind) {
      if (headset.fails) throw new Error(`no space: ${kind}`);
      return kind;
    }
    requestAnimationFrame(callback) {
      asked = callback;
    }
    async end() {
      asked = undefined;
      this.dispatchEvent(new Event('end'));
    }
  }

  globalThis.XRWebGLLayer = class {
    constructor(_, given) {
      layer = this;
      gl = given;
      const image = gl.createTexture();
      gl.bindTexture(gl.TEXTURE_2D, image);
      gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA8, 2 * SIZE[0], SIZE[1]);
      this.framebuffer = gl.createFramebuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, this.framebuffer);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, image, 0);
    }
    getViewport({ eye }) {
      return { x: eye === 'left' ? 0 : SIZE[0], y: 0, width: SIZE[0], height: SIZE[1] };
    }
  };
  WebGL2RenderingContext.prototype.makeXRCompatible = async () => {};

  const headset = (globalThis.headset = {
    matrix: column(0),
    time: 0,
    step(milliseconds = 100) {
      this.time += milliseconds;
      const views = ['left', 'right'].map((eye, k) => ({
        eye,
        transform: { matrix: times(this.matrix, column([-0.03, 0.03][k])) },
        projectionMatrix: projection([1, -1][k]),
      }));
      const [callback] = [asked];
      callback(this.time, { getViewerPose: () => ({ transform: { matrix: this.matrix }, views }) });
    },
    pixels() {
      const found = new Uint8Array(4 * 2 * SIZE[0] * SIZE[1]);
      gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
      gl.readPixels(0, 0, 2 * SIZE[0], SIZE[1], gl.RGBA, gl.UNSIGNED_BYTE, found);
      return [...found];
    },
  });
  Object.defineProperty(navigator, 'xr', {
    value: {
      isSessionSupported: async (kind) => kind === 'immersive-vr',
      requestSession: async () => (headset.session = new Session()),
    },
  });
})();
