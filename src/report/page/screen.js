// Draws images with WebGL2: one canvas, one rectangle of it for each panel.

let screen = null;

const VERTEX = `#version 300 es
void main() { gl_Position = vec4(vec2((gl_VertexID << 1) & 2, gl_VertexID & 2) * 2.0 - 1.0, 0.0, 1.0); }`;

const FRAGMENT = `#version 300 es
precision highp float;
precision highp int;
precision highp sampler2D;
uniform sampler2D one, other, colors;
uniform ivec2 size, otherSize;
uniform vec2 corner;     // lower left corner of the panel, in pixels of the canvas
uniform vec2 panel;      // its size
uniform vec2 origin;     // upper left corner of the image, from that of the panel
uniform float scale;     // pixels of the canvas for one of the image
uniform int mode;        // 0 image, 1 signed, 2 absolute, 3 relative difference
uniform int falseColor;  // 0 none, 1 linear, 2 by stops
uniform int operator;
uniform float gain, offset, gamma, white;
uniform bool display, marked;
uniform int shape;       // 0 flat, 1 ball, 2 panorama
uniform mat3 turn;
uniform float split;     // from here on the other image, as part of the panel; 2 for nowhere
out vec4 result;
${TONE_GLSL}
const float PI = 3.14159265358979;
vec4 texel(bool second, ivec2 at) { return second ? texelFetch(other, at, 0) : texelFetch(one, at, 0); }
// Color over black, and flags.
vec4 unpacked(vec4 value) {
  float flags = floor(value.a * 0.5);
  return vec4(value.rgb * (value.a - 2.0 * flags), flags);
}
vec4 merged(vec4 a, vec4 b) { return vec4(a.rgb + b.rgb, float(int(a.a) | int(b.a))); }
vec4 flat_(bool second, vec2 p, ivec2 size) {
  if (scale >= 1.0) return unpacked(texel(second, clamp(ivec2(floor(p)), ivec2(0), size - 1)));
  int n = min(int(ceil(1.0 / scale)), 16);
  vec4 sum = vec4(0.0);
  for (int j = 0; j < n; j++)
    for (int i = 0; i < n; i++) {
      vec2 q = p + (vec2(i, j) + 0.5) / float(n) / scale - 0.5 / scale;
      sum = merged(sum, unpacked(texel(second, clamp(ivec2(floor(q)), ivec2(0), size - 1))));
    }
  return vec4(sum.rgb / float(n * n), sum.a);
}
vec4 round_(bool second, vec2 position, ivec2 size, out bool isThere) {
  vec4 sum = vec4(0.0);
  isThere = false;
  float count = 0.0;
  for (int step = 0; step < 4; step++) {
    vec2 q = (position + (vec2(step & 1, step >> 1) - 0.5) * 0.5 - panel * 0.5) / (0.5 * min(panel.x, panel.y) * scale);
    q.y = -q.y;
    vec3 d;
    if (shape == 1) {
      float r = dot(q, q);
      if (r > 1.0) continue;
      d = turn * vec3(q, sqrt(1.0 - r));
    } else d = turn * normalize(vec3(q, -1.0));
    float u = atan(d.z, d.x) / (2.0 * PI);
    vec2 at = vec2(u - floor(u), acos(clamp(d.y, -1.0, 1.0)) / PI) * vec2(size);
    sum = merged(sum, unpacked(texel(second, clamp(ivec2(at), ivec2(0), size - 1))));
    count += 1.0;
    isThere = true;
  }
  return vec4(sum.rgb / max(count, 1.0), sum.a);
}
vec3 scaleColor(float value) { return texelFetch(colors, ivec2(int(clamp(value, 0.0, 1.0) * 255.0 + 0.5), falseColor == 0 && mode > 0 ? (mode == 1 ? 2 : 1) : 0), 0).rgb; }
float luminance(vec3 v) { return dot(v, vec3(0.2126, 0.7152, 0.0722)); }
void main() {
  vec2 position = vec2(gl_FragCoord.x - corner.x, panel.y - (gl_FragCoord.y - corner.y));
  bool second = position.x >= split * panel.x;
  ivec2 own = second ? otherSize : size;
  vec2 p = (position - origin) / scale;
  bool isThere = all(greaterThanEqual(p, vec2(0.0))) && all(lessThan(p, vec2(own)));
  vec4 found = shape == 0 ? flat_(second, p, own) : round_(second, position, own, isThere);
  if (!isThere) {
    result = vec4(vec3(0.082, 0.09, 0.106), 1.0);
    return;
  }
  int flags = int(found.a);
  vec3 light = found.rgb;
  if (mode > 0) {
    bool ignored;
    vec4 base = shape == 0 ? flat_(true, p, otherSize) : round_(true, position, otherSize, ignored);
    flags |= int(base.a);
    vec3 d = light - base.rgb;
    if (mode == 3) d = abs(d) / (abs(base.rgb) + 1e-3);
    float value = (mode == 1 ? (d.x + d.y + d.z) : (abs(d.x) + abs(d.y) + abs(d.z))) / 3.0 * gain;
    result = vec4(scaleColor(mode == 1 ? 0.5 + 0.5 * value : value), 1.0);
  } else if (falseColor > 0) {
    float value = luminance(max(light, vec3(0.0))) * gain + offset;
    result = vec4(scaleColor(falseColor == 1 ? value : (log2(max(value, 1e-30)) + 12.0) / 12.0), 1.0);
  } else {
    light = max(light, vec3(0.0)) * gain + offset;
    light = max(light, vec3(0.0));
    vec3 shown = clamp(toned(light, display ? 0 : operator, white), 0.0, 1.0);
    result = vec4(operator == 6 && !display ? shown : encoded(shown, display ? 0.0 : gamma), 1.0);
  }
  if (marked && flags > 0) result.rgb = (flags & 1) > 0 ? vec3(1.0, 0.0, 1.0) : (flags & 2) > 0 ? vec3(1.0, 0.88, 0.0) : vec3(0.0, 0.84, 1.0);
}`;

const UNIFORMS = ["one", "other", "colors", "size", "otherSize", "corner", "panel", "origin", "scale", "mode", "falseColor", "operator", "gain", "offset", "gamma", "white", "display", "marked", "shape", "turn", "split"];

/** Blue below, orange above, dark between: told apart by everyone, and what is equal does not dazzle. */
function divergingColor(t) {
  const ends = t < 0.5 ? [[96, 190, 255], [24, 26, 30]] : [[24, 26, 30], [255, 160, 60]];
  const part = t < 0.5 ? 2 * t : 2 * t - 1;
  return ends[0].map((from, channel) => Math.round(from + (ends[1][channel] - from) * part));
}

/** 256 colors of each scale: viridis, magma, diverging. */
function scaleColors() {
  const table = new Uint8Array(3 * 256 * 4);
  for (let entry = 0; entry < 256; entry++) {
    const colors = [COLORS.viridis, COLORS.magma].map((text) => [0, 2, 4].map((at) => parseInt(text.slice(6 * entry + at, 6 * entry + at + 2), 16)));
    colors.push(divergingColor(entry / 255));
    colors.forEach((color, row) => table.set([...color, 255], 4 * (256 * row + entry)));
  }
  return table;
}
const SCALE_TABLE = scaleColors();

/** Larger images are kept in half precision on the screen; values under the pointer are exact all the same. */
const FULL_PRECISION_PIXELS = 1 << 22;

function makeScreen(canvas) {
  const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, preserveDrawingBuffer: true });
  if (!gl) return null;
  const shader = (type, text) => {
    const made = gl.createShader(type);
    gl.shaderSource(made, text);
    gl.compileShader(made);
    if (!gl.getShaderParameter(made, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(made));
    return made;
  };
  const program = gl.createProgram();
  gl.attachShader(program, shader(gl.VERTEX_SHADER, VERTEX));
  gl.attachShader(program, shader(gl.FRAGMENT_SHADER, FRAGMENT));
  gl.linkProgram(program);
  gl.useProgram(program);
  const at = Object.fromEntries(UNIFORMS.map((name) => [name, gl.getUniformLocation(program, name)]));
  gl.bindVertexArray(gl.createVertexArray());
  gl.enable(gl.SCISSOR_TEST);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  const texture = () => {
    const made = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, made);
    for (const [name, value] of [["MIN_FILTER", "NEAREST"], ["MAG_FILTER", "NEAREST"], ["WRAP_S", "CLAMP_TO_EDGE"], ["WRAP_T", "CLAMP_TO_EDGE"]]) {
      gl.texParameteri(gl.TEXTURE_2D, gl["TEXTURE_" + name], gl[value]);
    }
    return made;
  };
  const colors = texture();
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, 256, 3, 0, gl.RGBA, gl.UNSIGNED_BYTE, SCALE_TABLE);
  const textures = new Map();
  const textureOf = (id, pixels) => {
    if (!textures.has(id)) {
      const { width, height, shown } = pixels;
      if (Math.max(width, height) > gl.getParameter(gl.MAX_TEXTURE_SIZE)) throw new Error("The image is larger than this graphics processor takes.");
      const isLarge = width * height > FULL_PRECISION_PIXELS;
      const made = texture();
      const values = isLarge ? shown.map((value) => Math.min(Math.max(value, -65504), 65504)) : shown;
      gl.texImage2D(gl.TEXTURE_2D, 0, isLarge ? gl.RGBA16F : gl.RGBA32F, width, height, 0, gl.RGBA, gl.FLOAT, values);
      textures.set(id, made);
    }
    return textures.get(id);
  };
  return {
    forget(id) {
      if (textures.has(id)) gl.deleteTexture(textures.get(id));
      textures.delete(id);
    },
    clear() {
      gl.scissor(0, 0, canvas.width, canvas.height);
      gl.clearColor(0.082, 0.09, 0.106, 1);
      gl.clear(gl.COLOR_BUFFER_BIT);
    },
    /** Draws a panel: `one`, and `other` where two are compared; each has `id` and `pixels`. */
    draw(panel, one, other, look) {
      const y = canvas.height - panel.y - panel.height;
      gl.viewport(panel.x, y, panel.width, panel.height);
      gl.scissor(panel.x, y, panel.width, panel.height);
      gl.activeTexture(gl.TEXTURE0);
      gl.bindTexture(gl.TEXTURE_2D, textureOf(one.id, one.pixels));
      gl.activeTexture(gl.TEXTURE1);
      gl.bindTexture(gl.TEXTURE_2D, textureOf((other ?? one).id, (other ?? one).pixels));
      gl.activeTexture(gl.TEXTURE2);
      gl.bindTexture(gl.TEXTURE_2D, colors);
      gl.activeTexture(gl.TEXTURE0);
      const second = (other ?? one).pixels;
      gl.uniform1i(at.one, 0);
      gl.uniform1i(at.other, 1);
      gl.uniform1i(at.colors, 2);
      gl.uniform2i(at.size, one.pixels.width, one.pixels.height);
      gl.uniform2i(at.otherSize, second.width, second.height);
      gl.uniform2f(at.corner, panel.x, y);
      gl.uniform2f(at.panel, panel.width, panel.height);
      gl.uniform2f(at.origin, ...look.origin);
      gl.uniform1f(at.scale, look.scale);
      for (const name of ["mode", "falseColor", "operator", "shape"]) gl.uniform1i(at[name], look[name]);
      for (const name of ["gain", "offset", "gamma", "white", "split"]) gl.uniform1f(at[name], look[name]);
      for (const name of ["display", "marked"]) gl.uniform1i(at[name], look[name] ? 1 : 0);
      gl.uniformMatrix3fv(at.turn, false, look.turn);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    },
  };
}
