// Draws scenes by WebGL 2.
import { half } from './half.js';
import { HARMONICS, ROW, SCREEN, SHAPE, SPLATS } from './shaders.js';

/** The graphics card, or its driver, does not do what is needed. */
export class DeviceError extends Error {}

function compile(gl, [vertex, fragment]) {
  const program = gl.createProgram();
  for (const [kind, text] of [
    [gl.VERTEX_SHADER, vertex],
    [gl.FRAGMENT_SHADER, fragment],
  ]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.bindAttribLocation(program, 0, 'gaussian');
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
    const logs = gl.getAttachedShaders(program).map((shader) => gl.getShaderInfoLog(shader));
    throw new DeviceError(`shaders: ${[gl.getProgramInfoLog(program), ...logs].join(' ').trim()}`);
  }
  const uniforms = {};
  const count = gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS);
  for (let k = 0; k < count; k++) {
    const { name } = gl.getActiveUniform(program, k);
    uniforms[name] = gl.getUniformLocation(program, name);
  }
  return { program, uniforms };
}

function texture(gl, format, width, height) {
  const made = gl.createTexture();
  gl.bindTexture(gl.TEXTURE_2D, made);
  gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, height);
  for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) {
    gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
  }
  return made;
}

/** A scene on the graphics card. */
export class Splats {
  constructor(gl, scene) {
    this.gl = gl;
    this.scene = scene;
    this.texels = HARMONICS[scene.degree];
    this.rows = Math.max(1, Math.ceil(scene.count / ROW));
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    if (this.rows > most || ROW * Math.max(SHAPE, this.texels) > most) {
      const limit = most * ROW;
      throw new DeviceError(
        `${scene.count} Gaussians, of which this device draws ${limit} at most`,
      );
    }
    this.shapes = texture(gl, gl.RGBA32F, ROW * SHAPE, this.rows);
    this.harmonics = texture(
      gl,
      gl.RGBA32UI,
      ROW * Math.max(1, this.texels),
      this.texels ? this.rows : 1,
    );
    if (gl.getError() === gl.OUT_OF_MEMORY) {
      throw new DeviceError(`${scene.count} Gaussians: the graphics card has no memory for them`);
    }
    this.order = gl.createBuffer();
    this.array = gl.createVertexArray();
    gl.bindVertexArray(this.array);
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribIPointer(0, 1, gl.UNSIGNED_INT, 0, 0);
    gl.vertexAttribDivisor(0, 1);
    this.drawn = 0;
  }

  /** Take what has been decoded of `count` Gaussians, from `first` on, up to a degree. */
  load(first, count, degree) {
    const [from, until] = [Math.floor(first / ROW), Math.ceil((first + count) / ROW)];
    // Rows at once: those at both ends are of other blocks too, which are loaded once more.
    if (degree === 0) this.#loadShapes(from, until);
    else this.#loadHarmonics(from, until);
  }

  #loadShapes(from, until) {
    const { gl, scene } = this;
    const { count, positions, fDc, opacity, logScale, rotation } = scene;
    const [begin, end] = [from * ROW, Math.min(until * ROW, count)];
    const values = new Float32Array((until - from) * ROW * SHAPE * 4);
    for (let i = begin, at = 0; i < end; i++, at += 4 * SHAPE) {
      let norm = 0;
      for (let k = 0; k < 4; k++) norm += rotation[k * count + i] ** 2;
      norm = Math.sqrt(norm);
      for (let k = 0; k < 3; k++) {
        values[at + k] = positions[k * count + i];
        values[at + 8 + k] = Math.exp(logScale[k * count + i]);
        values[at + 12 + k] = fDc[k * count + i];
      }
      values[at + 3] = 1 / (1 + Math.exp(-opacity[i]));
      for (let k = 0; k < 4; k++) {
        // A zero gives the identity.
        values[at + 4 + k] = norm > 0 ? rotation[k * count + i] / norm : Number(k === 0);
      }
    }
    gl.bindTexture(gl.TEXTURE_2D, this.shapes);
    const area = [0, from, ROW * SHAPE, until - from];
    gl.texSubImage2D(gl.TEXTURE_2D, 0, ...area, gl.RGBA, gl.FLOAT, values);
  }

  #loadHarmonics(from, until) {
    const { gl, scene, texels } = this;
    const { count, coefficients, fRest } = scene;
    const [begin, end] = [from * ROW, Math.min(until * ROW, count)];
    const values = new Uint16Array((until - from) * ROW * texels * 8);
    for (let k = 0; k < coefficients; k++) {
      for (let colour = 0; colour < 3; colour++) {
        const plane = (colour * coefficients + k) * count;
        let at = 3 * k + colour;
        for (let i = begin; i < end; i++, at += 8 * texels) values[at] = half(fRest[plane + i]);
      }
    }
    gl.bindTexture(gl.TEXTURE_2D, this.harmonics);
    const area = [0, from, ROW * texels, until - from];
    const words = new Uint32Array(values.buffer);
    gl.texSubImage2D(gl.TEXTURE_2D, 0, ...area, gl.RGBA_INTEGER, gl.UNSIGNED_INT, words);
  }

  /** Nothing more comes: keep what is needed to draw. */
  complete() {
    const { count, degree, antialiased } = this.scene;
    this.scene = { count, degree, antialiased };
  }

  /** Take the order in which to draw: farthest first. */
  sort(order) {
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.order);
    gl.bufferData(gl.ARRAY_BUFFER, order, gl.DYNAMIC_DRAW);
    this.drawn = order.length;
  }
}

/** Draws one or two scenes on a canvas. */
export class Renderer {
  constructor(canvas) {
    const wanted = { alpha: false, antialias: false, depth: false, preserveDrawingBuffer: true };
    const gl = canvas.getContext('webgl2', { ...wanted, powerPreference: 'high-performance' });
    if (!gl) throw new DeviceError('this browser has no WebGL 2');
    // Sums of many splats, each rounded to 8 bits, would be off by some levels.
    this.format = gl.getExtension('EXT_color_buffer_float') ? gl.RGBA16F : gl.RGBA8;
    this.canvas = canvas;
    this.gl = gl;
    this.splats = compile(gl, SPLATS);
    this.screen = compile(gl, SCREEN);
    this.nothing = gl.createVertexArray();
    this.pictures = [];
    this.size = [0, 0];
    this.fence = null; // of a picture that is being drawn
    this.begun = this.done = performance.now();
  }

  /** Whether the last picture is done. */
  isDone() {
    const { gl, fence } = this;
    if (!fence) return true;
    if (gl.clientWaitSync(fence, 0, 0) === gl.TIMEOUT_EXPIRED) return false;
    gl.deleteSync(fence);
    this.fence = null;
    this.done = performance.now();
    return true;
  }

  /** Milliseconds that the last picture took. */
  get took() {
    return this.done - this.begun;
  }

  /** Milliseconds since. */
  get rested() {
    return performance.now() - this.done;
  }

  #resize() {
    const { gl, canvas } = this;
    const size = [canvas.width, canvas.height];
    if (size.every((side, k) => side === this.size[k])) return;
    for (const { target, image } of this.pictures) {
      gl.deleteFramebuffer(target);
      gl.deleteTexture(image);
    }
    this.size = size;
    this.pictures = [0, 1].map(() => {
      const image = texture(gl, this.format, ...size);
      const target = gl.createFramebuffer();
      gl.bindFramebuffer(gl.FRAMEBUFFER, target);
      gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, image, 0);
      return { target, image };
    });
  }

  /**
   * Draw scenes.
   *
   * @param {{splats: Splats | null, axes: number[][]}[]} scenes one or two, and the axes of the world
   *   in theirs
   * @param {Pose} pose
   * @param {object} lens `focal` and `centre`, pixels of the canvas
   * @param {object} look `degree`, `background` (RGB, 0-1), `split` (0-1: the share of the width
   *   that the first scene has), `errors`
   */
  draw(scenes, pose, lens, look) {
    const { gl, screen } = this;
    this.begun = performance.now();
    this.#resize();
    const [width] = this.size;
    const line = Math.round(look.split * width);
    const spans = look.errors
      ? [
          [0, width],
          [0, width],
        ]
      : [
          [0, line],
          [line, width],
        ];
    gl.enable(gl.SCISSOR_TEST);
    scenes.forEach((scene, k) => {
      const [from, until] = spans[k];
      gl.scissor(from, 0, until - from, this.size[1]);
      if (from < until) this.#drawScene(this.pictures[k].target, scene, pose, lens, look.degree);
    });
    gl.disable(gl.SCISSOR_TEST);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, ...this.size);
    gl.disable(gl.BLEND);
    gl.useProgram(screen.program);
    gl.bindVertexArray(this.nothing);
    this.pictures.forEach(({ image }, k) => {
      gl.activeTexture(gl.TEXTURE0 + k);
      gl.bindTexture(gl.TEXTURE_2D, image);
      gl.uniform1i([screen.uniforms.first, screen.uniforms.second][k], k);
    });
    gl.uniform3fv(screen.uniforms.background, look.background);
    gl.uniform1f(screen.uniforms.split, line);
    gl.uniform1i(screen.uniforms.errors, look.errors);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    gl.activeTexture(gl.TEXTURE0);
    this.fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
  }

  #drawScene(target, { splats: scene, axes }, pose, { focal, centre }, degree) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.viewport(0, 0, ...this.size);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (!scene?.drawn) return;
    const { eye, turn } = pose.within(axes);
    const { program, uniforms } = this.splats;
    gl.useProgram(program);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, scene.shapes);
    gl.activeTexture(gl.TEXTURE1);
    gl.bindTexture(gl.TEXTURE_2D, scene.harmonics);
    gl.uniform1i(uniforms.shapes, 0);
    gl.uniform1i(uniforms.harmonics, 1);
    gl.uniformMatrix3fv(uniforms.turn, true, turn.flat());
    gl.uniform3fv(uniforms.eye, eye);
    gl.uniform2fv(uniforms.focal, focal);
    gl.uniform2fv(uniforms.centre, centre);
    gl.uniform2fv(uniforms.size, this.size);
    gl.uniform1i(uniforms.degree, Math.min(degree, scene.scene.degree));
    gl.uniform1i(uniforms.texels, scene.texels);
    gl.uniform1i(uniforms.antialiased, scene.scene.antialiased);
    gl.bindVertexArray(scene.array);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, scene.drawn);
    gl.activeTexture(gl.TEXTURE0);
  }
}
