// What the page holds: results, images, and their pixels, which are unpacked when they are asked for.

const data = JSON.parse(document.getElementById("data").textContent);
const folder = document.getElementById("folder").textContent;
const byPlace = new Map(data.images.map((image, id) => [image.place, id]));
const embedded = new Set(data.embedded);

/** An element with attributes and children; texts are texts, never markup. */
function make(name, attributes = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (key === "class") element.className = value;
    else if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (value === true) element.setAttribute(key, "");
    else if (value !== false && value != null) element.setAttribute(key, value);
  }
  element.append(...children.filter((child) => child != null));
  return element;
}

const waiting = new Map();

// Called by the files beside the page.
globalThis.pipelineData = (name, text) => {
  waiting.get(name)?.(text);
  waiting.delete(name);
};

/** The packed text of a result: from the page, or from a file beside it. */
function packedText(name) {
  if (embedded.has(name)) return Promise.resolve(document.getElementById("data-" + name).textContent);
  return new Promise((resolve, reject) => {
    waiting.set(name, resolve);
    const script = make("script", { src: folder + "/" + name + ".js" });
    script.addEventListener("error", () => {
      waiting.delete(name);
      reject(new Error("The pixels are in the folder “" + folder + "”, which is not beside this page."));
    });
    script.addEventListener("load", () => script.remove());
    document.head.append(script);
  });
}

function bytesOf(text) {
  const raw = atob(text);
  const bytes = new Uint8Array(raw.length);
  for (let at = 0; at < raw.length; at++) bytes[at] = raw.charCodeAt(at);
  return bytes;
}

/** Undoes `packed_floats`: channels of `count` floats each. */
async function floatsOf(text) {
  const stream = new Blob([bytesOf(text)]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  for (let at = 1; at < bytes.length; at++) bytes[at] += bytes[at - 1];
  return bytes;
}

function channelOf(bytes, count, channel) {
  const bits = new Uint32Array(count);
  const [a, b, c, d] = [0, 1, 2, 3].map((plane) => (4 * channel + plane) * count);
  for (let at = 0; at < count; at++) {
    bits[at] = (bytes[a + at] << 24) | (bytes[b + at] << 16) | (bytes[c + at] << 8) | bytes[d + at];
  }
  return new Float32Array(bits.buffer);
}

/** Linear light of each code of an sRGB picture. */
const decodedCode = Float32Array.from({ length: 256 }, (_, code) => {
  const v = code / 255;
  return v <= 0.04045 ? v / 12.92 : Math.pow((v + 0.055) / 1.055, 2.4);
});

const FLAG = { nan: 1, infinite: 2, negative: 4 };
const GREATEST = 3.4028234663852886e38;

/** Pixels for the screen: linear color that is finite, and coverage + 2 flags; and what they were. */
function texels(width, height, red, green, blue, alpha) {
  const count = width * height;
  const shown = new Float32Array(4 * count);
  const values = new Float32Array(3 * count);
  for (let at = 0; at < count; at++) {
    let flags = 0;
    const coverage = alpha ? alpha[at] : 1;
    for (let channel = 0; channel < 3; channel++) {
      const value = (channel === 0 ? red : channel === 1 ? green : blue)[at];
      values[3 * at + channel] = value;
      let finite = value;
      if (value !== value) { flags |= FLAG.nan; finite = 0; }
      else if (value === Infinity) { flags |= FLAG.infinite; finite = GREATEST; }
      else if (value < 0) { flags |= value === -Infinity ? FLAG.infinite | FLAG.negative : FLAG.negative; if (value === -Infinity) finite = -GREATEST; }
      shown[4 * at + channel] = finite;
    }
    shown[4 * at + 3] = Math.min(Math.max(coverage, 0), 1) + (coverage > 0 ? 2 * flags : 0);
  }
  return { width, height, shown, values, alpha };
}

async function pictureOf(text, width, height) {
  const blob = new Blob([bytesOf(text)], { type: "image/png" });
  const bitmap = await createImageBitmap(blob, { premultiplyAlpha: "none", colorSpaceConversion: "none" });
  const canvas = make("canvas", { width, height });
  const context = canvas.getContext("2d", { willReadFrequently: true });
  context.drawImage(bitmap, 0, 0);
  bitmap.close();
  const codes = context.getImageData(0, 0, width, height).data;
  const channel = (offset) => Float32Array.from({ length: width * height }, (_, at) => decodedCode[codes[4 * at + offset]]);
  const alpha = Float32Array.from({ length: width * height }, (_, at) => codes[4 * at + 3] / 255);
  return Object.assign(texels(width, height, channel(0), channel(1), channel(2), alpha.some((v) => v < 1) ? alpha : null), { codes });
}

const pixelCache = new Map();
const KEPT = 24;

/** Pixels of an image; the last ones are kept. */
function pixelsOf(id) {
  const image = data.images[id];
  if (!pixelCache.has(id)) {
    const [width, height] = image.size ?? [0, 0];
    const loaded = !image.data
      ? Promise.reject(new Error("“" + image.place + "” is gone from the store and the outputs."))
      : packedText(image.data).then(async (text) => {
          if (image.display) return pictureOf(text, width, height);
          const bytes = await floatsOf(text);
          const count = width * height;
          const channels = [0, 1, 2].map((channel) => channelOf(bytes, count, channel));
          return texels(width, height, ...channels, bytes.length > 12 * count ? channelOf(bytes, count, 3) : null);
        });
    pixelCache.set(id, loaded);
    loaded.catch(() => pixelCache.delete(id));
    if (pixelCache.size > KEPT) {
      const [oldest] = pixelCache.keys();
      pixelCache.delete(oldest);
      screen?.forget(oldest);
    }
  }
  return pixelCache.get(id);
}

const markCache = new Map();

/** Points or regions that can be laid over a map. */
function marksOf(index) {
  if (!markCache.has(index)) {
    const marks = data.marks[index];
    const length = marks.count * (marks.regions ? 6 : 2);
    markCache.set(index, packedText(marks.data).then(floatsOf).then((bytes) => channelOf(bytes, length, 0)));
  }
  return markCache.get(index);
}

/** A number for people: five digits. */
function numberText(value) {
  if (value == null) return "–";
  if (!Number.isFinite(value)) return Number.isNaN(value) ? "NaN" : value > 0 ? "∞" : "−∞";
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-4 || size >= 1e6)) return value.toExponential(4);
  return String(Number(value.toPrecision(5)));
}
