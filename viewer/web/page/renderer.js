// Draw scenes with WebGL 2.
import { fraction, half, pair } from './half.js';
import { ROW } from './limits.js';
import { HARMONICS, PROJECTION, SCREEN, SHAPE, SPLATS } from './shaders.js';
import { counted, number, say } from './strings.js';

/** The graphics card or its driver lacks a required feature. */
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

/** A framebuffer of textures. */
function targetOf(gl, ...images) {
  const target = gl.createFramebuffer();
  gl.bindFramebuffer(gl.FRAMEBUFFER, target);
  const places = images.map((_, k) => gl.COLOR_ATTACHMENT0 + k);
  places.forEach((place, k) =>
    gl.framebufferTexture2D(gl.FRAMEBUFFER, place, gl.TEXTURE_2D, images[k], 0),
  );
  gl.drawBuffers(places);
  return target;
}

/** A scene on the graphics card. */
export class Splats {
  constructor(gl, scene) {
    this.gl = gl;
    this.scene = scene;
    this.texels = HARMONICS[scene.degree];
    this.rows = Math.max(1, Math.ceil(scene.count / ROW));
    const most = gl.getParameter(gl.MAX_TEXTURE_SIZE);
    const isTooLarge = this.rows > most || ROW * Math.max(SHAPE, this.texels) > most;
    if (isTooLarge && !gl.isContextLost()) {
      const [gaussians, limit] = [counted(scene.count, 'Gaussian'), number(most * ROW)];
      throw new DeviceError(say('{}, this device draws at most {}', gaussians, limit));
    }
    this.shapes = texture(gl, gl.RGBA32UI, ROW * SHAPE, this.rows);
    this.harmonics = texture(
      gl,
      gl.RGBA32UI,
      ROW * Math.max(1, this.texels),
      this.texels ? this.rows : 1,
    );
    this.order = texture(gl, gl.R32UI, ROW, this.rows);
    this.projected = [0, 1].map(() => texture(gl, gl.RGBA32UI, ROW, this.rows));
    this.target = targetOf(gl, ...this.projected);
    if (gl.getError() === gl.OUT_OF_MEMORY) {
      this.dispose();
      const gaussians = counted(scene.count, 'Gaussian');
      throw new DeviceError(say('{}: the graphics card has too little memory', gaussians));
    }
    this.drawn = 0;
  }

  /**
   * Copy `count` Gaussians of a scene, from `begin` on, up to a degree, to those from `first` on.
   */
  load(scene, begin, first, count, degree) {
    const [from, until] = [Math.floor(first / ROW), Math.ceil((first + count) / ROW)];
    // Upload whole rows: the Gaussians before and after belong to other blocks, which are uploaded
    // again, or are not drawn.
    const shift = begin - first;
    const span = [from * ROW + shift, Math.min(until * ROW + shift, scene.count)];
    if (degree === 0) this.#loadShapes(scene, span, from, until);
    else this.#loadHarmonics(scene, span, from, until);
  }

  /**
   * Copy `rows` rows from another of the same degree for each `[from, to]`, numbers of Gaussians.
   */
  copy(other, moves, rows) {
    const { gl } = this;
    for (const [name, texels] of [
      ['shapes', SHAPE],
      ['harmonics', this.texels],
    ]) {
      if (texels === 0) continue;
      const source = targetOf(gl, other[name]);
      gl.bindTexture(gl.TEXTURE_2D, this[name]);
      for (const [from, to] of moves) {
        const area = [0, to / ROW, 0, from / ROW, ROW * texels, rows];
        gl.copyTexSubImage2D(gl.TEXTURE_2D, 0, ...area);
      }
      gl.deleteFramebuffer(source);
    }
  }

  #loadShapes(scene, [begin, end], from, until) {
    const { gl } = this;
    const { count, positions, fDc, opacity, logScale, rotation } = scene;
    const words = new Uint32Array((until - from) * ROW * SHAPE * 4);
    const floats = new Float32Array(words.buffer);
    const turn = [0, 0, 0, 0];
    for (let i = begin, at = 0; i < end; i++, at += 4 * SHAPE) {
      for (let k = 0; k < 3; k++) {
        floats[at + k] = positions[k * count + i];
        floats[at + 4 + k] = Math.exp(logScale[k * count + i]);
      }
      floats[at + 3] = 1 / (1 + Math.exp(-opacity[i]));
      words[at + 7] = pair(half(fDc[i]), half(fDc[count + i]));
      let norm = 0;
      for (let k = 0; k < 4; k++) norm += (turn[k] = rotation[k * count + i]) ** 2;
      norm = Math.sqrt(norm);
      // A zero gives the identity.
      for (let k = 0; k < 4; k++) turn[k] = fraction(norm > 0 ? turn[k] / norm : Number(k === 0));
      words[at + 8] = pair(turn[0], turn[1]);
      words[at + 9] = pair(turn[2], turn[3]);
      words[at + 10] = half(fDc[2 * count + i]);
    }
    gl.bindTexture(gl.TEXTURE_2D, this.shapes);
    const area = [0, from, ROW * SHAPE, until - from];
    gl.texSubImage2D(gl.TEXTURE_2D, 0, ...area, gl.RGBA_INTEGER, gl.UNSIGNED_INT, words);
  }

  #loadHarmonics(scene, [begin, end], from, until) {
    const { gl, texels } = this;
    const { count, coefficients, fRest } = scene;
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

  /** Keep only what is needed to draw, because the scene is complete. */
  complete() {
    const { count, degree, antialiased } = this.scene;
    this.scene = { count, degree, antialiased };
  }

  /** Free memory on the graphics card. */
  dispose() {
    const { gl, shapes, harmonics, order, projected, target } = this;
    gl.deleteFramebuffer(target);
    for (const image of [shapes, harmonics, order, ...projected]) gl.deleteTexture(image);
  }

  /** Set the drawing order: farthest first. */
  sort(order) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, this.order);
    const rows = Math.floor(order.length / ROW);
    for (const [from, width, height] of [
      [0, ROW, rows],
      [rows, order.length % ROW, 1],
    ]) {
      if (width * height === 0) continue;
      const area = [0, from, width, height];
      const place = from * ROW;
      gl.texSubImage2D(gl.TEXTURE_2D, 0, ...area, gl.RED_INTEGER, gl.UNSIGNED_INT, order, place);
    }
    this.drawn = order.length;
  }
}

/** Draws one or two scenes on a canvas. */
export class Renderer {
  constructor(canvas) {
    const wanted = { alpha: false, antialias: false, depth: false, preserveDrawingBuffer: true };
    const gl = canvas.getContext('webgl2', { ...wanted, powerPreference: 'high-performance' });
    if (!gl) throw new DeviceError(say('this browser has no WebGL 2'));
    // With 8 bits, rounding errors of many splats would add up to several levels.
    this.format = gl.getExtension('EXT_color_buffer_float') ? gl.RGBA16F : gl.RGBA8;
    this.canvas = canvas;
    this.gl = gl;
    this.projection = compile(gl, PROJECTION);
    this.splats = compile(gl, SPLATS);
    this.screen = compile(gl, SCREEN);
    this.pictures = [];
    this.size = [0, 0];
    this.fence = null; // of the picture being drawn
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

  /** Milliseconds since then. */
  get rested() {
    return performance.now() - this.done;
  }

  #resize(size) {
    const { gl } = this;
    if (size.every((side, k) => side === this.size[k])) return;
    for (const { target, image } of this.pictures) {
      gl.deleteFramebuffer(target);
      gl.deleteTexture(image);
    }
    this.size = size;
    this.pictures = [0, 1].map(() => {
      const image = texture(gl, this.format, ...size);
      return { image, target: targetOf(gl, image) };
    });
  }

  /**
   * Draw scenes.
   *
   * @param {{splats: Splats | null, axes: number[][]}[]} scenes one or two, with the world's axes
   *   in theirs
   * @param {Pose} pose
   * @param {object} lens `focal` and `centre`, pixels of the canvas
   * @param {object} look `degree`, `background` (RGB, 0-1), `split` (0-1: the first scene's share
   *   of the width), `errors`
   * @param {object} [target] `framebuffer`, `corner` and `size` in it; by default the canvas
   */
  draw(scenes, pose, lens, look, target) {
    const { gl, screen, canvas } = this;
    if (!target) this.begun = performance.now();
    const { framebuffer, corner, size } = target ?? {
      framebuffer: null,
      corner: [0, 0],
      size: [canvas.width, canvas.height],
    };
    this.#resize(size);
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
    scenes.forEach(({ splats, axes }, k) => {
      const [from, until] = spans[k];
      if (from >= until) return;
      if (splats?.drawn) this.#project(splats, pose.within(axes), lens, spans[k], look.degree);
      this.#drawScene(this.pictures[k].target, splats, spans[k]);
    });
    gl.bindFramebuffer(gl.FRAMEBUFFER, framebuffer);
    gl.viewport(...corner, ...size);
    gl.disable(gl.BLEND);
    gl.useProgram(screen.program);
    const [first, second] = this.pictures.map(({ image }) => image);
    this.#sample(screen.uniforms, { first, second });
    gl.uniform3fv(screen.uniforms.background, look.background);
    gl.uniform1f(screen.uniforms.split, line);
    gl.uniform2fv(screen.uniforms.corner, corner);
    gl.uniform1i(screen.uniforms.errors, look.errors);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    if (target) return;
    this.fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    const watch = () => this.isDone() || requestAnimationFrame(watch);
    requestAnimationFrame(watch); // `took` ends when the picture is done, not when the next begins
  }

  /** Bind textures to samplers of a program. */
  #sample(uniforms, textures) {
    const { gl } = this;
    Object.entries(textures).forEach(([name, image], k) => {
      gl.activeTexture(gl.TEXTURE0 + k);
      gl.bindTexture(gl.TEXTURE_2D, image);
      gl.uniform1i(uniforms[name], k);
    });
    gl.activeTexture(gl.TEXTURE0);
  }

  /** Project a scene's Gaussians, and compute colours of those visible from `from` to `until`. */
  #project(splats, { eye, turn }, { focal, centre, near }, span, degree) {
    const { gl } = this;
    const { program, uniforms } = this.projection;
    gl.bindFramebuffer(gl.FRAMEBUFFER, splats.target);
    gl.viewport(0, 0, ROW, splats.rows);
    gl.disable(gl.BLEND);
    gl.useProgram(program);
    this.#sample(uniforms, { shapes: splats.shapes, harmonics: splats.harmonics });
    gl.uniformMatrix3fv(uniforms.turn, true, turn.flat());
    gl.uniform3fv(uniforms.eye, eye);
    gl.uniform2fv(uniforms.focal, focal);
    gl.uniform1f(uniforms.nearest, near);
    gl.uniform2fv(uniforms.centre, centre);
    gl.uniform2fv(uniforms.size, this.size);
    gl.uniform2fv(uniforms.span, span);
    gl.uniform1i(uniforms.degree, Math.min(degree, splats.scene.degree));
    gl.uniform1i(uniforms.texels, splats.texels);
    gl.uniform1i(uniforms.antialiased, splats.scene.antialiased);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  }

  #drawScene(target, splats, [from, until]) {
    const { gl, size } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, target);
    gl.viewport(0, 0, ...size);
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(from, 0, until - from, size[1]);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (splats?.drawn) this.#splat(splats);
    gl.disable(gl.SCISSOR_TEST);
  }

  #splat({ order, projected: [places, lights], drawn }) {
    const { gl } = this;
    const { program, uniforms } = this.splats;
    gl.useProgram(program);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    this.#sample(uniforms, { order, places, lights });
    gl.uniform2fv(uniforms.size, this.size);
    gl.drawArrays(gl.TRIANGLES, 0, 3 * drawn);
  }
}
