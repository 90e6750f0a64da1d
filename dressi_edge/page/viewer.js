"use strict";
// A GLB as dressi_edge writes it, in a canvas that is turned with the mouse: WebGL 2, no library.
//
// In: the file's bytes, and cameras {pose: 12 numbers (world to camera, rows), fx, fy, cx, cy, width, height}.
// Out: pictures. Colours: linear inside, sRGB on the screen; unlit surfaces as they are, others under a light beside the eye.

const TYPES = {5120: Int8Array, 5121: Uint8Array, 5122: Int16Array, 5123: Uint16Array, 5125: Uint32Array, 5126: Float32Array};
const WIDTHS = {SCALAR: 1, VEC2: 2, VEC3: 3, VEC4: 4, MAT4: 16};

const VERTEX = `#version 300 es
layout(location=0) in vec3 position; layout(location=1) in vec3 normal; layout(location=2) in vec2 uv;
layout(location=3) in vec4 color; layout(location=4) in vec2 uv1;
uniform mat4 toWorld, toClip; out vec3 at, n; out vec2 t, t1; out vec4 c;
void main() {
  vec4 p = toWorld * vec4(position, 1.0);
  at = p.xyz; n = mat3(toWorld) * normal; t = uv; t1 = uv1; c = color; gl_Position = toClip * p; gl_PointSize = 3.0;
}`;

const FRAGMENT = `#version 300 es
precision highp float;
in vec3 at, n; in vec2 t, t1; in vec4 c; out vec4 result;
uniform vec3 eye, right, up, emissive; uniform vec4 base; uniform vec2 rough; // metallic, roughness
uniform int mode; uniform bool unlit; uniform float cutoff, bump; uniform bvec4 has; uniform bvec4 second; uniform bool hasLight;
uniform sampler2D map, roughMap, bumpMap, lightMap;
vec3 srgb(vec3 x) { return mix(12.92 * x, 1.055 * pow(max(x, 0.0031308), vec3(1.0 / 2.4)) - 0.055, step(0.0031308, x)); }
vec3 lit(vec3 N, vec3 V, vec3 L, vec3 color, float metal, float r) {
  vec3 H = normalize(L + V); float nl = max(dot(N, L), 0.0), nv = max(dot(N, V), 1e-3), nh = max(dot(N, H), 0.0);
  float a = max(r * r, 1e-3), a2 = a * a, k = (r + 1.0) * (r + 1.0) / 8.0, d = nh * nh * (a2 - 1.0) + 1.0;
  vec3 f0 = mix(vec3(0.04), color, metal), F = f0 + (1.0 - f0) * pow(1.0 - max(dot(H, V), 0.0), 5.0);
  vec3 shine = F * (a2 / (3.14159 * d * d)) / (4.0 * (nl * (1.0 - k) + k) * (nv * (1.0 - k) + k));
  return ((1.0 - F) * (1.0 - metal) * color / 3.14159 + shine) * nl;
}
void main() {
  vec4 color = base * c;
  if (has.x) color *= texture(map, second.x ? t1 : t);
  if (mode == 0 && color.a < cutoff) discard;
  vec3 V = normalize(eye - at), N = normalize(n);
  if (dot(n, n) < 1e-12) N = normalize(cross(dFdx(at), dFdy(at)));
  if (!gl_FrontFacing) N = -N;
  if (has.z && mode != 1) {
    vec2 w = second.z ? t1 : t; vec3 px = dFdx(at), py = dFdy(at); vec2 tx = dFdx(w), ty = dFdy(w);
    vec3 T = px * ty.y - py * tx.y, B = -px * ty.x + py * tx.x; float s = inversesqrt(max(max(dot(T, T), dot(B, B)), 1e-20));
    vec3 m = texture(bumpMap, w).xyz * 2.0 - 1.0; N = normalize(T * s * m.x * bump - B * s * m.y * bump + N * m.z);
  }
  if (mode == 2) { result = vec4(N * 0.5 + 0.5, 1.0); return; }
  if (mode == 0 && unlit) { result = vec4(srgb(clamp(color.rgb, 0.0, 1.0)), 1.0); return; }
  vec3 albedo = mode == 1 ? vec3(0.62) : color.rgb; vec2 mr = mode == 1 ? vec2(0.0, 0.7) : rough;
  if (has.y && mode == 0) mr *= texture(roughMap, second.y ? t1 : t).bg;
  vec3 back = cross(right, up);
  vec3 light = 3.0 * lit(N, V, normalize(0.5 * right + 0.7 * up + back), albedo, mr.x, mr.y)
    + 0.9 * lit(N, V, normalize(-0.9 * right + 0.1 * up + 0.5 * back), albedo, mr.x, mr.y)
    + albedo * mix(0.10, 0.28, dot(N, up) * 0.5 + 0.5);
  if (mode == 0) light += emissive * (hasLight ? texture(lightMap, second.w ? t1 : t).rgb : vec3(1.0));
  result = vec4(srgb(clamp(light, 0.0, 1.0)), 1.0);
}`;

const LINES = `#version 300 es
precision highp float; in vec4 c; out vec4 result; uniform vec4 ink; void main() { result = ink; }`;

function add(a, b, s = 1) { return [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]]; }
function dot(a, b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
function cross(a, b) { return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]; }
function scaled(a, s) { return [a[0] * s, a[1] * s, a[2] * s]; }
function unit(a) { return scaled(a, 1 / (Math.hypot(...a) || 1)); }
function times(a, b) { // column-major 4 x 4
  const m = new Float64Array(16);
  for (let i = 0; i < 4; i++) for (let j = 0; j < 4; j++) for (let k = 0; k < 4; k++) m[4 * j + i] += a[4 * k + i] * b[4 * j + k];
  return m;
}

function matrixOf(node) {
  if (node.matrix) return Float64Array.from(node.matrix);
  const [x, y, z, w] = node.rotation || [0, 0, 0, 1], s = node.scale || [1, 1, 1], p = node.translation || [0, 0, 0];
  return Float64Array.from([
    s[0] * (1 - 2 * (y * y + z * z)), s[0] * 2 * (x * y + z * w), s[0] * 2 * (x * z - y * w), 0,
    s[1] * 2 * (x * y - z * w), s[1] * (1 - 2 * (x * x + z * z)), s[1] * 2 * (y * z + x * w), 0,
    s[2] * 2 * (x * z + y * w), s[2] * 2 * (y * z - x * w), s[2] * (1 - 2 * (x * x + y * y)), 0, p[0], p[1], p[2], 1]);
}

class Glb {
  constructor(bytes) {
    const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
    if (view.getUint32(0, true) !== 0x46546c67) throw new Error("the model is no GLB");
    const size = view.getUint32(12, true);
    this.json = JSON.parse(new TextDecoder().decode(bytes.subarray(20, 20 + size)));
    this.data = bytes.subarray(28 + size, 28 + size + view.getUint32(20 + size, true));
  }
  view(k) { const v = this.json.bufferViews[k]; return this.data.subarray(v.byteOffset || 0, (v.byteOffset || 0) + v.byteLength); }
  accessor(k) { // tightly packed numbers, as they are
    const a = this.json.accessors[k], width = WIDTHS[a.type], bytes = this.view(a.bufferView).slice(a.byteOffset || 0);
    return {array: new TYPES[a.componentType](bytes.buffer, 0, a.count * width), width, type: a.componentType, count: a.count,
      normalized: !!a.normalized};
  }
  pieces() { // [{primitive, matrix}] of the scene
    const found = [], nodes = this.json.nodes || [];
    const walk = (k, above) => {
      const node = nodes[k], m = times(above, matrixOf(node));
      if (node.mesh !== undefined) for (const primitive of this.json.meshes[node.mesh].primitives) found.push({primitive, matrix: m});
      (node.children || []).forEach(child => walk(child, m));
    };
    this.json.scenes[this.json.scene || 0].nodes.forEach(k => walk(k, matrixOf({})));
    return found;
  }
}

class Viewer {
  constructor(canvas) {
    this.canvas = canvas;
    this.gl = canvas.getContext("webgl2", {antialias: true, premultipliedAlpha: true, alpha: true});
    this.mode = 0; this.wire = false; this.showCameras = false; this.pieces = []; this.cameras = []; this.ink = [0.2, 0.45, 0.9, 1];
    if (!this.gl) return;
    this.surface = this.program(FRAGMENT); this.lines = this.program(LINES);
    this.frusta = this.gl.createVertexArray(); this.frustaBuffer = this.gl.createBuffer(); this.frustaCount = 0;
    this.place({up: [0, 1, 0], center: [0, 0, 0], radius: 1, from: [0.5, 0.35, 1]});
    this.listen();
    new ResizeObserver(() => this.draw()).observe(canvas);
  }

  program(fragment) {
    const gl = this.gl, p = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, fragment]]) {
      const s = gl.createShader(kind); gl.shaderSource(s, text); gl.compileShader(s);
      if (!gl.getShaderParameter(s, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(s));
      gl.attachShader(p, s);
    }
    gl.linkProgram(p);
    const at = {}, count = gl.getProgramParameter(p, gl.ACTIVE_UNIFORMS);
    for (let k = 0; k < count; k++) { const {name} = gl.getActiveUniform(p, k); at[name] = gl.getUniformLocation(p, name); }
    return {p, at};
  }

  // ---- what is shown

  async load(bytes, cameras, keep = false) {
    const gl = this.gl;
    if (!gl) return;
    const glb = new Glb(bytes), pieces = [], low = [Infinity, Infinity, Infinity], high = low.map(x => -x), textures = new Map();
    const texture = (info, color) => {
      if (!info) return null;
      const key = `${info.index} ${color}`;
      if (!textures.has(key)) textures.set(key, this.texture(glb, glb.json.textures[info.index], color));
      return {promise: textures.get(key), second: info.texCoord || 0};
    };
    for (const {primitive, matrix} of glb.pieces()) {
      const positions = glb.accessor(primitive.attributes.POSITION);
      for (let k = 0; k < positions.count; k++) {
        for (let i = 0; i < 3; i++) {
          const x = matrix[i] * positions.array[3 * k] + matrix[4 + i] * positions.array[3 * k + 1]
            + matrix[8 + i] * positions.array[3 * k + 2] + matrix[12 + i];
          if (x < low[i]) low[i] = x;
          if (x > high[i]) high[i] = x;
        }
      }
      const m = (glb.json.materials || [])[primitive.material] || {}, pbr = m.pbrMetallicRoughness || {};
      const maps = {base: texture(pbr.baseColorTexture, true), rough: texture(pbr.metallicRoughnessTexture, false),
        bump: texture(m.normalTexture, false), light: texture(m.emissiveTexture, true)};
      const extensions = m.extensions || {}, strong = (extensions.KHR_materials_emissive_strength || {}).emissiveStrength || 1;
      pieces.push({...this.buffers(glb, primitive), matrix, maps, base: pbr.baseColorFactor || [1, 1, 1, 1],
        metallic: pbr.metallicFactor ?? 1, roughness: pbr.roughnessFactor ?? 1, emissive: scaled(m.emissiveFactor || [0, 0, 0], strong),
        unlit: !!extensions.KHR_materials_unlit, cutoff: m.alphaMode === "MASK" ? m.alphaCutoff ?? 0.5 : 0,
        bump: (m.normalTexture || {}).scale ?? 1});
    }
    for (const piece of pieces) {
      for (const [name, found] of Object.entries(piece.maps)) {
        piece.maps[name] = found && found.second < 2 ? {texture: await found.promise, second: found.second === 1} : null;
      }
    }
    this.forget(); this.pieces = pieces;
    this.cameras = cameras || [];
    if (!keep || !this.offset) this.offset = scaled(add(low, high), 0.5); // all is drawn about it: fp32 has few digits far from the origin
    for (const piece of pieces) for (let i = 0; i < 3; i++) piece.matrix[12 + i] -= this.offset[i];
    const center = add(scaled(add(low, high), 0.5), this.offset, -1), radius = Math.max(Math.hypot(...add(high, low, -1)) / 2, 1e-9);
    this.plain = pieces.every(p => p.unlit && !p.colored && (!p.maps.base || p.maps.base.texture.even)); // without light an outline alone
    this.counts = {faces: pieces.reduce((n, p) => n + p.count / 3, 0), vertices: pieces.reduce((n, p) => n + p.vertices, 0)};
    if (!keep) this.frame(center, radius);
    this.drawFrusta(radius);
    this.draw();
  }

  frame(center, radius) { // look from where the first camera does, with the cameras' own up
    const rows = this.cameras.map(c => c.pose), up = rows.length
      ? unit(rows.reduce((sum, r) => add(sum, unit([r[4], r[5], r[6]])), [0, 0, 0])) : [0, 1, 0];
    const first = rows.length ? add(this.eyeOf(rows[0]), center, -1) : [0.5, 0.35, 1];
    this.place({up: Math.hypot(...up) > 0.5 ? up : [0, 1, 0], center, radius, from: first});
  }

  forget() {
    for (const piece of this.pieces) {
      this.gl.deleteVertexArray(piece.array); piece.made.forEach(b => this.gl.deleteBuffer(b));
      Object.values(piece.maps).forEach(m => m && this.gl.deleteTexture(m.texture));
    }
  }

  buffers(glb, primitive) {
    const gl = this.gl, array = gl.createVertexArray(), made = [];
    gl.bindVertexArray(array);
    const fill = (target, data) => {
      const buffer = gl.createBuffer(); made.push(buffer); gl.bindBuffer(target, buffer); gl.bufferData(target, data, gl.STATIC_DRAW);
    };
    const places = {POSITION: 0, NORMAL: 1, TEXCOORD_0: 2, COLOR_0: 3, TEXCOORD_1: 4};
    gl.vertexAttrib4f(3, 1, 1, 1, 1);
    let count = 0;
    for (const [name, place] of Object.entries(places)) {
      if (primitive.attributes[name] === undefined) continue;
      const a = glb.accessor(primitive.attributes[name]);
      fill(gl.ARRAY_BUFFER, a.array); gl.enableVertexAttribArray(place);
      gl.vertexAttribPointer(place, a.width, a.type, a.normalized, 0, 0);
      count = a.count;
    }
    const index = primitive.indices === undefined ? Uint32Array.from({length: count}, (_, k) => k)
      : Uint32Array.from(glb.accessor(primitive.indices).array);
    const edges = new Uint32Array(2 * index.length);
    for (let k = 0; k < index.length; k += 3) {
      for (let i = 0; i < 3; i++) { edges[2 * (k + i)] = index[k + i]; edges[2 * (k + i) + 1] = index[k + (i + 1) % 3]; }
    }
    const both = new Uint32Array(index.length + edges.length); both.set(index); both.set(edges, index.length);
    fill(gl.ELEMENT_ARRAY_BUFFER, both);
    gl.bindVertexArray(null);
    return {array, made, count: index.length, vertices: count, colored: primitive.attributes.COLOR_0 !== undefined};
  }

  async texture(glb, record, color) {
    const gl = this.gl, image = glb.json.images[record.source], sampler = (glb.json.samplers || [])[record.sampler] || {};
    const bitmap = await createImageBitmap(new Blob([glb.view(image.bufferView)], {type: image.mimeType}),
      {premultiplyAlpha: "none", colorSpaceConversion: "none"});
    const texture = gl.createTexture(), small = new OffscreenCanvas(16, 16).getContext("2d", {willReadFrequently: true});
    small.drawImage(bitmap, 0, 0, 16, 16);
    const seen = small.getImageData(0, 0, 16, 16).data; // 1024 numbers, four of a texel
    texture.even = [0, 1, 2].every(c => {
      const x = seen.filter((_, k) => k % 4 === c);
      return Math.max(...x) - Math.min(...x) < 4;
    });
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, color ? gl.SRGB8_ALPHA8 : gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, bitmap);
    gl.generateMipmap(gl.TEXTURE_2D);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR_MIPMAP_LINEAR);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, sampler.wrapS || gl.REPEAT);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, sampler.wrapT || gl.REPEAT);
    return texture;
  }

  drawFrusta(radius) {
    const gl = this.gl, points = [];
    for (const c of this.cameras) {
      const p = c.pose, eye = this.eyeOf(p), depth = 0.18 * radius;
      const corner = (u, v) => {
        const x = (u - c.cx) / c.fx * depth, y = -(v - c.cy) / c.fy * depth, z = -depth;
        return add(eye, [p[0] * x + p[4] * y + p[8] * z, p[1] * x + p[5] * y + p[9] * z, p[2] * x + p[6] * y + p[10] * z]);
      };
      const corners = [corner(0, 0), corner(c.width, 0), corner(c.width, c.height), corner(0, c.height)];
      corners.forEach((q, k) => points.push(...eye, ...q, ...q, ...corners[(k + 1) % 4]));
    }
    this.frustaCount = points.length / 3;
    gl.bindVertexArray(this.frusta); gl.bindBuffer(gl.ARRAY_BUFFER, this.frustaBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(points), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0); gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.bindVertexArray(null);
  }

  eyeOf(p) { return [0, 1, 2].map(i => -(p[i] * p[3] + p[4 + i] * p[7] + p[8 + i] * p[11]) - (this.offset || [0, 0, 0])[i]); }

  // ---- where from

  place({up, center, radius, from}) {
    this.up = up; this.center = center.slice(); this.radius = radius;
    const side = Math.abs(up[0]) < 0.9 ? [1, 0, 0] : [0, 0, 1];
    this.e1 = unit(add(side, up, -dot(side, up))); this.e2 = cross(up, this.e1);
    const d = unit(from);
    this.pitch = Math.asin(Math.max(-0.999, Math.min(0.999, dot(d, up)))); this.yaw = Math.atan2(dot(d, this.e2), dot(d, this.e1));
    this.distance = 2.9 * radius;
    this.home = {up, center: center.slice(), radius, from};
  }
  reset() { this.place(this.home); this.draw(); }
  turn(yaw, pitch) { this.yaw += yaw; this.pitch = Math.max(-1.55, Math.min(1.55, this.pitch + pitch)); this.draw(); }
  zoom(factor) { this.distance = Math.max(0.02 * this.radius, Math.min(50 * this.radius, this.distance * factor)); this.draw(); }
  pan(dx, dy) {
    const {right, up} = this.axes(), s = this.distance * 2 * Math.tan(0.3) / this.canvas.clientHeight;
    this.center = add(add(this.center, right, -dx * s), up, dy * s); this.draw();
  }
  look(camera) { // from where a camera stands
    const eye = this.eyeOf(camera.pose), d = add(eye, this.home.center, -1);
    this.center = this.home.center.slice(); this.distance = Math.hypot(...d);
    const n = unit(d); this.pitch = Math.asin(dot(n, this.up)); this.yaw = Math.atan2(dot(n, this.e2), dot(n, this.e1)); this.draw();
  }
  axes() {
    const c = Math.cos(this.pitch), back = add(add(scaled(this.e1, c * Math.cos(this.yaw)), this.e2, c * Math.sin(this.yaw)), this.up,
      Math.sin(this.pitch));
    const right = unit(cross(this.up, back));
    return {back, right, up: cross(back, right), eye: add(this.center, back, this.distance)};
  }

  listen() {
    const held = new Map(), c = this.canvas;
    let spread = 0;
    c.addEventListener("pointerdown", e => { c.focus({preventScroll: true}); c.setPointerCapture(e.pointerId); held.set(e.pointerId, e); });
    c.addEventListener("pointermove", e => {
      const before = held.get(e.pointerId);
      if (!before) return;
      const dx = e.clientX - before.clientX, dy = e.clientY - before.clientY;
      held.set(e.pointerId, e);
      if (held.size === 2) {
        const [a, b] = held.values(), now = Math.hypot(a.clientX - b.clientX, a.clientY - b.clientY);
        if (spread) this.zoom(spread / now);
        spread = now;
      } else if (e.buttons & 6 || e.shiftKey) this.pan(dx, dy);
      else this.turn(-dx * 0.008, dy * 0.008);
    });
    for (const name of ["pointerup", "pointercancel"]) c.addEventListener(name, e => { held.delete(e.pointerId); spread = 0; });
    c.addEventListener("contextmenu", e => e.preventDefault());
    c.addEventListener("dblclick", () => this.reset());
    c.addEventListener("wheel", e => { // only once it was clicked: else the page could not be scrolled past it
      if (document.activeElement !== c) return;
      e.preventDefault(); this.zoom(Math.exp(Math.sign(e.deltaY) * Math.min(Math.abs(e.deltaY), 100) * 0.002));
    }, {passive: false});
    c.addEventListener("keydown", e => {
      const turns = {ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1]}[e.key];
      if (turns) this.turn(...turns); else if (e.key === "+" || e.key === "=") this.zoom(0.9); else if (e.key === "-") this.zoom(1.1);
      else if (e.key === "0") this.reset(); else return;
      e.preventDefault();
    });
  }

  // ---- drawing

  draw() {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(() => { this.asked = false; this.render(); });
  }

  render() {
    const gl = this.gl, c = this.canvas, ratio = Math.min(window.devicePixelRatio || 1, 2);
    const w = Math.max(1, Math.round(c.clientWidth * ratio)), h = Math.max(1, Math.round(c.clientHeight * ratio));
    if (c.width !== w || c.height !== h) { c.width = w; c.height = h; }
    const {back, right, up, eye} = this.axes(), far = this.distance + 60 * this.radius, near = Math.max(this.distance / 200, far * 1e-5);
    const f = 1 / Math.tan(0.3), toEye = Float64Array.from([right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2],
      0, -dot(right, eye), -dot(up, eye), -dot(back, eye), 1]);
    const wide = w < h ? w / h : 1;
    const toClip = times(Float64Array.from([f * wide * h / w, 0, 0, 0, 0, f * wide, 0, 0, 0, 0, -(far + near) / (far - near), -1, 0, 0,
      -2 * far * near / (far - near), 0]), toEye);
    gl.viewport(0, 0, w, h); gl.clearColor(0, 0, 0, 0); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT); gl.enable(gl.DEPTH_TEST);
    const {p, at} = this.surface;
    gl.useProgram(p);
    gl.uniformMatrix4fv(at.toClip, false, new Float32Array(toClip));
    gl.uniform3fv(at.eye, eye); gl.uniform3fv(at.right, right); gl.uniform3fv(at.up, up); gl.uniform1i(at.mode, this.mode);
    ["map", "roughMap", "bumpMap", "lightMap"].forEach((name, k) => gl.uniform1i(at[name], k));
    gl.enable(gl.POLYGON_OFFSET_FILL); gl.polygonOffset(1, 1);
    for (const piece of this.pieces) {
      const maps = [piece.maps.base, piece.maps.rough, piece.maps.bump, piece.maps.light];
      maps.forEach((m, k) => { gl.activeTexture(gl.TEXTURE0 + k); gl.bindTexture(gl.TEXTURE_2D, m ? m.texture : null); });
      gl.uniformMatrix4fv(at.toWorld, false, new Float32Array(piece.matrix)); gl.uniform4fv(at.base, piece.base);
      gl.uniform2f(at.rough, piece.metallic, piece.roughness); gl.uniform3fv(at.emissive, piece.emissive);
      gl.uniform1i(at.unlit, piece.unlit); gl.uniform1f(at.cutoff, piece.cutoff); gl.uniform1f(at.bump, piece.bump);
      gl.uniform4iv(at.has, maps.map(m => m ? 1 : 0)); gl.uniform4iv(at.second, maps.map(m => m && m.second ? 1 : 0));
      gl.uniform1i(at.hasLight, maps[3] ? 1 : 0);
      gl.bindVertexArray(piece.array);
      if (!piece.colored) gl.vertexAttrib4f(3, 1, 1, 1, 1);
      gl.drawElements(gl.TRIANGLES, piece.count, gl.UNSIGNED_INT, 0);
    }
    gl.disable(gl.POLYGON_OFFSET_FILL);
    gl.useProgram(this.lines.p);
    gl.uniformMatrix4fv(this.lines.at.toClip, false, new Float32Array(toClip));
    if (this.wire) {
      gl.uniform4f(this.lines.at.ink, 0.1, 0.1, 0.12, 1);
      for (const piece of this.pieces) {
        gl.uniformMatrix4fv(this.lines.at.toWorld, false, new Float32Array(piece.matrix)); gl.bindVertexArray(piece.array);
        gl.drawElements(gl.LINES, 2 * piece.count, gl.UNSIGNED_INT, 4 * piece.count);
      }
    }
    if (this.showCameras && this.frustaCount) {
      gl.uniform4fv(this.lines.at.ink, this.ink); gl.uniformMatrix4fv(this.lines.at.toWorld, false, new Float32Array(matrixOf({})));
      gl.bindVertexArray(this.frusta); gl.drawArrays(gl.LINES, 0, this.frustaCount);
    }
    gl.bindVertexArray(null);
    this.drawn = (this.drawn || 0) + 1;
  }
}
