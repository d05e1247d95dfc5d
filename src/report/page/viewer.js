// The viewer: several images under one pointer, one zoom and one exposure. Its state is in the address.

const MODES = { side: "Side by side", split: "Split", flip: "Flip", diff: "Difference" };
const DIFFERENCES = { signed: 1, absolute: 2, relative: 3 };
const SHAPES = { flat: 0, ball: 1, inside: 2 };
const FALSE = { none: 0, linear: 1, stops: 2 };
const START = { mode: "side", diff: "absolute", current: 0, ev: 0, dstops: null, offset: 0, operator: "linear", gamma: "srgb", color: "none", shape: "flat", yaw: 0, pitch: 0, zoom: null, x: null, y: null, split: 0.5, marks: -1, flags: true, pixel: null, reference: null };

let view = null;

/** Opens images in the viewer; with what an address says, if there is one. */
function openViewer(ids, given = {}) {
  ids = ids.filter((id) => data.images[id]);
  if (!ids.length) return;
  closeViewer();
  const first = data.images[ids[0]];
  const declared = data.images[ids[0]].ref;
  if (ids.length === 1 && declared != null && given.reference === undefined) given = { ...given, reference: declared };
  view = { ...START, ev: first.display ? 0 : (first.stops ?? 0), ids, loaded: new Map(), problem: "", before: document.activeElement, ...given };
  buildViewer();
  load();
}

function closeViewer() {
  if (!view) return;
  const { root, before, watcher } = view;
  watcher?.disconnect();
  root.remove();
  view = null;
  screen = null;
  document.body.style.overflow = "";
  history.replaceState(null, "", location.pathname + location.search);
  before?.focus?.();
}

function load() {
  const wanted = new Set(view.ids);
  if (view.reference != null) wanted.add(view.reference);
  for (const id of wanted) {
    if (view.loaded.has(id)) continue;
    const own = view;
    pixelsOf(id).then((pixels) => {
      if (view !== own) return;
      own.loaded.set(id, pixels);
      refresh();
    }, (error) => {
      if (view !== own) return;
      own.problem = error.message;
      refresh();
    });
  }
  refresh();
}

/** The image that others are compared with: the declared reference, or the first of several. */
function referenceId() {
  if (view.reference != null) return view.reference;
  return view.ids.length > 1 ? view.ids[0] : null;
}

const isRound = () => view.shape !== "flat" && data.images[view.ids[0]].map;

/** What is drawn: panels with one image, or two. */
function panels() {
  const base = referenceId();
  const compared = view.ids.filter((id) => id !== base);
  const current = view.ids[Math.min(view.current, view.ids.length - 1)];
  if (view.mode === "flip") return [{ one: current }];
  if (view.mode === "split" && base != null) return [{ one: base, other: current === base ? (compared[0] ?? base) : current }];
  if (view.mode === "diff" && base != null) return (compared.length ? compared : view.ids).map((id) => ({ one: id, other: base }));
  const ids = view.reference != null && !view.ids.includes(view.reference) ? [...view.ids, view.reference] : view.ids;
  return ids.map((id) => ({ one: id }));
}

function layout() {
  const { width, height } = view.canvas;
  const shown = panels();
  const size = data.images[view.ids[0]].size ?? [1, 1];
  const aspect = isRound() ? 1 : size[0] / size[1];
  let best = { columns: 1, scale: 0 };
  for (let columns = 1; columns <= shown.length; columns++) {
    const rows = Math.ceil(shown.length / columns);
    const scale = Math.min(width / columns / aspect, height / rows);
    if (scale > best.scale * 1.001) best = { columns, rows, scale };
  }
  const [w, h] = [Math.floor(width / best.columns), Math.floor(height / best.rows)];
  return shown.map((panel, index) => ({
    ...panel,
    x: (index % best.columns) * w + (index % best.columns ? 1 : 0),
    y: Math.floor(index / best.columns) * h + (index >= best.columns ? 1 : 0),
    width: w - (index % best.columns ? 1 : 0),
    height: h - (index >= best.columns ? 1 : 0),
  }));
}

function fitZoom(panel) {
  const [width, height] = data.images[view.ids[0]].size ?? [1, 1];
  return isRound() ? 0.94 : Math.min(panel.width / width, panel.height / height);
}

/** Where the image lies in a panel: pixels of the image stay on pixels of the screen. */
function place(panel) {
  const [width, height] = data.images[view.ids[0]].size ?? [1, 1];
  const scale = view.zoom ?? fitZoom(panel);
  const origin = [Math.round(panel.width / 2 - (view.x ?? width / 2) * scale), Math.round(panel.height / 2 - (view.y ?? height / 2) * scale)];
  return { scale, origin };
}

const isDifference = () => view.mode === "diff" && referenceId() != null;

/** Stops of the scale of differences: as given, or so that one in a hundred of the pixels is beyond it. */
function differenceStops() {
  if (view.dstops != null) return view.dstops;
  const base = view.loaded.get(referenceId());
  const found = [];
  for (const { one, other } of panels()) {
    const pixels = view.loaded.get(one);
    if (other == null || !base || !pixels || pixels.values.length !== base.values.length) continue;
    const step = 3 * Math.max(1, Math.floor(pixels.values.length / 3 / 4096));
    for (let at = 0; at < pixels.values.length; at += step) {
      const sum = [0, 1, 2].reduce((sum, channel) => {
        const d = Math.abs(pixels.values[at + channel] - base.values[at + channel]);
        return sum + (view.diff === "relative" ? d / (Math.abs(base.values[at + channel]) + 1e-3) : d) / 3;
      }, 0);
      if (Number.isFinite(sum) && sum > 0) found.push(sum);
    }
  }
  if (!found.length) return 0;
  found.sort((one, other) => one - other);
  return Math.max(-16, Math.min(16, Math.round(-Math.log2(found[Math.floor(0.99 * (found.length - 1))]) * 4) / 4));
}

function look(panel) {
  const { scale, origin } = place(panel);
  return {
    scale,
    origin,
    mode: view.mode === "diff" && panel.other != null ? DIFFERENCES[view.diff] : 0,
    falseColor: FALSE[view.color],
    operator: Math.max(0, OPERATORS.indexOf(view.operator)),
    gain: 2 ** (isDifference() && panel.other != null ? differenceStops() : view.ev),
    offset: view.offset,
    gamma: view.gamma === "srgb" ? 0 : Number(view.gamma),
    white: 4,
    display: data.images[panel.one].display,
    marked: view.flags,
    shape: isRound() ? SHAPES[view.shape] : 0,
    turn: turnMatrix(view.yaw, view.pitch),
    split: view.mode === "split" && panel.other != null ? view.split : 2,
  };
}

function refresh() {
  if (!view || view.isDrawing) return;
  view.isDrawing = true;
  requestAnimationFrame(() => {
    if (!view) return;
    view.isDrawing = false;
    draw();
    showSide();
    showControls();
    keepAddress();
  });
}

function draw() {
  const { canvas, over } = view;
  const ratio = globalThis.devicePixelRatio || 1;
  const box = view.box.getBoundingClientRect();
  for (const target of [canvas, over]) {
    const [width, height] = [Math.max(1, Math.round(box.width * ratio)), Math.max(1, Math.round(box.height * ratio))];
    if (target.width !== width || target.height !== height) [target.width, target.height] = [width, height];
  }
  view.layout = layout();
  const paint = over.getContext("2d");
  paint.clearRect(0, 0, over.width, over.height);
  view.message.hidden = !view.problem;
  view.message.textContent = view.problem;
  view.root.dataset.drawn = "no";
  if (!screen) return view.layout.forEach((panel) => drawPreview(panel, paint, ratio));
  screen.clear();
  let isWhole = view.marks < 0 || Boolean(view.markValues?.has(view.marks));
  for (const panel of view.layout) {
    const one = view.loaded.get(panel.one);
    const other = panel.other == null ? null : view.loaded.get(panel.other);
    isWhole &&= Boolean(one && (panel.other == null || other));
    if (one && (panel.other == null || other)) {
      try {
        screen.draw(panel, { id: panel.one, pixels: one }, other && { id: panel.other, pixels: other }, look(panel));
      } catch (error) {
        view.message.hidden = false;
        view.message.textContent = error.message;
      }
    }
    paintOver(paint, panel, ratio);
  }
  if (isWhole) view.root.dataset.drawn = "yes";
}

/** Without WebGL: the preview, as it is. */
function drawPreview(panel, paint, ratio) {
  const image = document.querySelector(`[data-image="${panel.one}"] img`);
  const canvas = view.canvas.getContext("2d");
  if (canvas && image) {
    const { scale, origin } = place(panel);
    const [width, height] = data.images[panel.one].size;
    canvas.save();
    canvas.beginPath();
    canvas.rect(panel.x, panel.y, panel.width, panel.height);
    canvas.clip();
    canvas.clearRect(panel.x, panel.y, panel.width, panel.height);
    canvas.imageSmoothingEnabled = false;
    canvas.drawImage(image, panel.x + origin[0], panel.y + origin[1], width * scale, height * scale);
    canvas.restore();
  }
  paintOver(paint, panel, ratio);
}

/** Names, marks, and the pixel that is looked at. */
function paintOver(paint, panel, ratio) {
  paint.save();
  paint.beginPath();
  paint.rect(panel.x, panel.y, panel.width, panel.height);
  paint.clip();
  paint.translate(panel.x, panel.y);
  if (view.marks >= 0) paintMarks(paint, panel, ratio);
  const { scale, origin } = place(panel);
  if (view.pixel && !isRound()) {
    paint.lineWidth = Math.max(1, ratio);
    const side = Math.max(scale, 5 * ratio);
    const [x, y] = [0, 1].map((axis) => origin[axis] + (view.pixel[axis] + 0.5) * scale - side / 2);
    paint.strokeStyle = "#000";
    paint.strokeRect(x - ratio, y - ratio, side + 2 * ratio, side + 2 * ratio);
    paint.strokeStyle = "#fff";
    paint.strokeRect(x, y, side, side);
  }
  if (view.mode === "split" && panel.other != null) {
    paint.fillStyle = "#fff";
    paint.fillRect(Math.round(view.split * panel.width) - ratio, 0, 2 * ratio, panel.height);
    label(paint, panel, name(panel.one), 8 * ratio, "left", ratio);
    label(paint, panel, name(panel.other), panel.width - 8 * ratio, "right", ratio);
  } else {
    const text = look(panel).mode ? name(panel.one) + " − " + name(panel.other) : name(panel.one);
    label(paint, panel, (view.loaded.has(panel.one) ? "" : "loading ") + text, 8 * ratio, "left", ratio);
  }
  paint.restore();
}

function label(paint, panel, text, x, align, ratio) {
  paint.font = `${12 * ratio}px system-ui, "DejaVu Sans", sans-serif`;
  paint.textAlign = align;
  paint.textBaseline = "top";
  const width = Math.min(paint.measureText(text).width, panel.width - 16 * ratio);
  paint.fillStyle = "rgb(0 0 0 / .62)";
  paint.fillRect((align === "left" ? x : x - width) - 4 * ratio, 5 * ratio, width + 8 * ratio, 18 * ratio);
  paint.fillStyle = "#fff";
  paint.fillText(text, x, 8 * ratio, width);
}

function name(id) {
  const index = view.ids.indexOf(id);
  return (index >= 0 && view.ids.length > 1 ? index + 1 + "  " : "") + data.images[id].place;
}

function marksFor(id) {
  const [width, height] = data.images[id].size ?? [];
  return data.marks.map((marks, index) => ({ marks, index })).filter(({ marks }) => {
    const size = marks.size ?? (marks.of == null ? null : data.images[marks.of].size);
    return size && size[0] === width && size[1] === height;
  });
}

function paintMarks(paint, panel, ratio) {
  const marks = data.marks[view.marks];
  const values = view.markValues?.get(view.marks);
  const size = data.images[panel.one].size;
  if (!marks || !values || !size) return;
  const { scale, origin } = place(panel);
  const { shape, turn } = look(panel);
  const at = (x, y) => (shape === 0 ? [origin[0] + x * scale, origin[1] + y * scale] : placeOnSphere(x / size[0], y / size[1], shape, turn, panel, scale));
  paint.lineWidth = 1.5 * ratio;
  const step = marks.regions ? 6 : 2;
  for (let start = 0; start < values.length; start += step) {
    if (marks.regions) {
      const [x0, y0, x1, y1] = values.subarray(start, start + 4);
      paint.strokeStyle = "#56b4e9";
      edge(paint, at, shape, [[x0, y0], [x1, y0], [x1, y1], [x0, y1], [x0, y0]], size);
    }
    const found = at(values[start + step - 2], values[start + step - 1]);
    if (!found) continue;
    paint.beginPath();
    paint.arc(found[0], found[1], 3 * ratio, 0, 7);
    paint.fillStyle = "#ffb000";
    paint.fill();
    paint.strokeStyle = "#000";
    paint.lineWidth = ratio;
    paint.stroke();
    paint.lineWidth = 1.5 * ratio;
  }
}

/** A line on the map; on a ball its pieces are short enough to look bent. */
function edge(paint, at, shape, corners, size) {
  paint.beginPath();
  let isDown = false;
  for (let corner = 0; corner + 1 < corners.length; corner++) {
    const [[x0, y0], [x1, y1]] = [corners[corner], corners[corner + 1]];
    const pieces = shape === 0 ? 1 : Math.max(1, Math.ceil((64 * (Math.abs(x1 - x0) + Math.abs(y1 - y0))) / size[0]));
    for (let piece = 0; piece <= pieces; piece++) {
      const found = at(x0 + ((x1 - x0) * piece) / pieces, y0 + ((y1 - y0) * piece) / pieces);
      if (found) paint[isDown ? "lineTo" : "moveTo"](...found);
      isDown = Boolean(found);
    }
  }
  paint.stroke();
}

function pixelText(id, pixels, x, y) {
  if (!pixels || x < 0 || y < 0 || x >= pixels.width || y >= pixels.height) return "";
  const at = y * pixels.width + x;
  const values = [0, 1, 2].map((channel) => numberText(pixels.values[3 * at + channel]).padStart(10));
  const codes = pixels.codes ? "\n    codes " + [0, 1, 2].map((channel) => pixels.codes[4 * at + channel]).join(" ") : "";
  return values.join(" ") + (pixels.alpha && pixels.alpha[at] < 1 ? "\n    alpha " + numberText(pixels.alpha[at]) : "") + codes;
}

/** Values under the pointer, and what is known of each image. */
function showSide() {
  const base = referenceId();
  const ids = base != null && !view.ids.includes(base) ? [...view.ids, base] : view.ids;
  const [x, y] = view.pixel ?? [-1, -1];
  const baseAt = base == null ? null : view.loaded.get(base);
  const items = ids.map((id, index) => {
    const image = data.images[id];
    const pixels = view.loaded.get(id);
    const stats = image.stats;
    const bad = stats ? [["nan", stats.nan, "NaN"], ["inf", stats.infinite, "infinite"], ["neg", stats.negative, "negative"]].filter((entry) => entry[1] > 0) : [];
    const text = pixelText(id, pixels, x, y);
    const difference = text && baseAt && id !== base ? "\nΔ" + [0, 1, 2].map((channel) => numberText(pixels.values[3 * (y * pixels.width + x) + channel] - (baseAt.values[3 * (y * baseAt.width + x) + channel] ?? NaN)).padStart(channel ? 10 : 9)).join(" ") : "";
    return make("div", { class: "panel" + (view.mode === "flip" && view.ids[view.current] === id ? " current" : "") },
      make("h4", {}, make("b", {}, id === base ? "ref" : String(index + 1)), make("span", {}, image.place),
        make("button", { type: "button", title: "Where it comes from", onclick: () => showJob(image.job) }, "info"),
        view.ids.includes(id) && view.ids.length > 1 ? make("button", { type: "button", title: "Take it out", "aria-label": "Take it out", onclick: () => takeOut(id) }, "×") : null),
      make("p", { class: "values" }, text ? text + difference : " "),
      make("p", { class: "stats" }, image.size ? image.size.join(" × ") : "gone", stats ? `, min ${numberText(stats.min)}, mean ${numberText(stats.mean)}, max ${numberText(stats.max)}` : ""),
      ...bad.map(([kind, count, word]) => make("p", { class: "stats worse" }, make("i", { class: "swatch " + kind }), ` ${count} ${word} pixel${count === 1 ? "" : "s"}`)));
  });
  const at = view.pixel ? `pixel ${x}, ${y}` : "Point at a pixel to see its values (scene-linear).";
  view.side.replaceChildren(make("p", { class: "quiet" }, at), ...items, ...legend(), adder());
}

function legend() {
  const hasDifference = isDifference();
  if (!hasDifference && view.color === "none") return [];
  const row = hasDifference ? (view.diff === "signed" ? 2 : 1) : 0;
  const canvas = make("canvas", { width: 256, height: 1 });
  const paint = canvas.getContext("2d");
  paint.putImageData(new ImageData(new Uint8ClampedArray(SCALE_TABLE.slice(1024 * row, 1024 * (row + 1))), 256, 1), 0, 0);
  const top = 2 ** -(hasDifference ? differenceStops() : view.ev);
  const [from, to, what] = hasDifference
    ? view.diff === "signed" ? [numberText(-top), numberText(top), "mean of the channels' differences"]
      : [0, numberText(top), view.diff === "relative" ? "mean of |difference| / (|reference| + 0.001)" : "mean of |difference|"]
    : view.color === "linear" ? [0, numberText(top), "luminance"] : [numberText(top / 4096), numberText(top), "luminance, 12 stops"];
  return [make("p", { class: "stats" }, what), make("div", { class: "legendbar" }, from, canvas, to)];
}

function adder() {
  const options = data.images.map((image, id) => ({ image, id })).filter(({ image, id }) => image.data && !view.ids.includes(id));
  const size = String(data.images[view.ids[0]].size);
  const same = options.filter(({ image }) => String(image.size) === size);
  const option = ({ image, id }) => make("option", { value: id }, image.place);
  return make("select", { "aria-label": "Add an image", onchange: (event) => { view.ids = [...view.ids, Number(event.target.value)]; load(); } },
    make("option", { value: "" }, "Add an image …"), ...same.slice(0, 2000).map(option));
}

function takeOut(id) {
  view.ids = view.ids.filter((other) => other !== id);
  view.current = Math.min(view.current, view.ids.length - 1);
  refresh();
}

function set(change) {
  Object.assign(view, change);
  if (change.reference !== undefined) load();
  if (change.marks !== undefined && change.marks >= 0) {
    const own = view;
    marksOf(change.marks).then((values) => {
      own.markValues = (own.markValues ?? new Map()).set(change.marks, values);
      refresh();
    }, (error) => { own.problem = error.message; refresh(); });
  }
  refresh();
}

function chooser(key, options, title) {
  const select = make("select", { onchange: (event) => set({ [key]: event.target.value }) }, ...options.map((option) => make("option", { value: option }, option)));
  view.controls.push(() => { select.value = view[key]; });
  return make("label", {}, title, select);
}

function slider(key, title, min, max, step, unit) {
  const output = make("output");
  const input = make("input", { type: "range", min, max, step, "aria-label": title, oninput: (event) => set({ [key]: Number(event.target.value) }), ondblclick: () => set({ [key]: 0 }) });
  view.controls.push(() => {
    input.value = view[key];
    output.textContent = (view[key] > 0 ? "+" : view[key] < 0 ? "−" : "") + Math.abs(view[key]).toFixed(2) + unit;
  });
  return make("label", {}, title, input, output);
}

/** The exposure, or the scale of differences where they are shown. */
function exposure() {
  const title = make("span");
  const output = make("output");
  const input = make("input", { type: "range", min: -16, max: 16, step: 0.25, "aria-label": "exposure in stops",
    oninput: (event) => set({ [isDifference() ? "dstops" : "ev"]: Number(event.target.value) }),
    ondblclick: () => set(isDifference() ? { dstops: null } : { ev: 0 }) });
  view.controls.push(() => {
    const stops = isDifference() ? differenceStops() : view.ev;
    title.textContent = isDifference() ? "differences" : "exposure";
    input.value = stops;
    output.textContent = (stops > 0 ? "+" : stops < 0 ? "−" : "") + Math.abs(stops).toFixed(2);
  });
  return make("label", { title: "in stops; a double click sets it back" }, title, input, output);
}

function brighter(stops) {
  set(isDifference() ? { dstops: differenceStops() + stops } : { ev: view.ev + stops });
}

function buttons(key, options) {
  const made = Object.entries(options).map(([value, text]) => {
    const button = make("button", { type: "button", onclick: () => set({ [key]: value }) }, text);
    view.controls.push(() => button.setAttribute("aria-pressed", view[key] === value));
    return button;
  });
  return make("span", { class: "buttons", role: "group" }, ...made);
}

function buildViewer() {
  view.controls = [];
  view.canvas = make("canvas", { "aria-label": "Images" });
  view.over = make("canvas", { class: "over", "aria-hidden": "true" });
  view.message = make("p", { class: "message", role: "status", hidden: true });
  view.box = make("div", { class: "stagebox", tabindex: 0, "aria-label": "Images; the keys are listed under ?" }, view.canvas, view.over, view.message);
  view.side = make("aside", { "aria-label": "Values" });
  const isMap = data.images[view.ids[0]].map;
  const marks = marksFor(view.ids[0]);
  const marksChoice = make("select", { onchange: (event) => set({ marks: Number(event.target.value) }) }, make("option", { value: -1 }, "none"),
    ...marks.map(({ marks, index }) => make("option", { value: index }, marks.place)));
  view.controls.push(() => { marksChoice.value = view.marks; });
  const referenceChoice = make("select", { onchange: (event) => set({ reference: event.target.value === "" ? null : Number(event.target.value) }) });
  const size = String(data.images[view.ids[0]].size);
  const declared = new Set(view.ids.map((id) => data.images[id].ref).filter((id) => id != null));
  if (view.reference != null) declared.add(view.reference);
  const references = [...declared, ...view.ids.filter((id) => !declared.has(id)), ...(view.ids.length === 1 ? sameGroup(view.ids[0]).filter((id) => !declared.has(id)) : [])];
  referenceChoice.append(make("option", { value: "" }, view.ids.length > 1 ? "the first" : "none"),
    ...references.filter((id) => String(data.images[id].size) === size).map((id) => make("option", { value: id }, data.images[id].place)));
  view.controls.push(() => { referenceChoice.value = view.reference ?? ""; });
  const flags = make("input", { type: "checkbox", onchange: (event) => set({ flags: event.target.checked }) });
  view.controls.push(() => { flags.checked = view.flags; });
  const zoomText = make("output");
  view.controls.push(() => { zoomText.textContent = isRound() ? "" : Math.round(100 * place(view.layout?.[0] ?? { width: 1, height: 1 }).scale) + " %"; });
  view.root = make("div", { id: "viewer", role: "dialog", "aria-modal": "true", "aria-label": "Viewer" },
    make("div", { class: "strip" },
      buttons("mode", MODES),
      chooser("diff", Object.keys(DIFFERENCES), "difference"),
      make("label", {}, "reference", referenceChoice),
      isMap ? chooser("shape", Object.keys(SHAPES), "shape") : null,
      marks.length ? make("label", {}, "marks", marksChoice) : null,
      make("span", {}, make("button", { type: "button", onclick: () => set({ zoom: null, x: null, y: null, yaw: 0, pitch: 0 }) }, "Fit"), " ",
        make("button", { type: "button", onclick: () => set({ zoom: 1 }) }, "1:1"), " ", zoomText),
      make("button", { type: "button", onclick: showKeys, title: "Keys" }, "?"),
      make("button", { type: "button", class: "close", onclick: closeViewer, title: "Close (Escape)" }, "Close")),
    view.box, view.side,
    make("div", { class: "strip bottom" },
      exposure(),
      slider("offset", "offset", -1, 1, 0.01, ""),
      chooser("operator", OPERATORS, "operator"),
      chooser("gamma", ["srgb", "1", "1.8", "2.1", "2.2", "2.4", "2.5", "3"], "gamma"),
      chooser("color", Object.keys(FALSE), "false color"),
      make("label", { title: "NaN magenta, infinite yellow, negative blue" }, flags, "mark odd pixels")));
  document.body.append(view.root);
  document.body.style.overflow = "hidden";
  screen = makeScreen(view.canvas);
  if (!screen) view.problem = "This browser has no WebGL2: what is seen are previews; the values are exact.";
  listen(view.box);
  view.watcher = new ResizeObserver(refresh);
  view.watcher.observe(view.box);
  if (view.marks >= 0) set({ marks: view.marks });
  view.box.focus();
}

function sameGroup(id) {
  return data.images.map((image, other) => ({ image, other })).filter(({ image, other }) => image.group === data.images[id].group && other !== id).map(({ other }) => other);
}

function showControls() {
  view.controls.forEach((show) => show());
}

/** The panel under a point of the window, and the point in it in pixels of the canvas. */
function under(event) {
  const box = view.box.getBoundingClientRect();
  const ratio = view.canvas.width / box.width;
  const [x, y] = [(event.clientX - box.left) * ratio, (event.clientY - box.top) * ratio];
  const panel = view.layout?.find((panel) => x >= panel.x && y >= panel.y && x < panel.x + panel.width && y < panel.y + panel.height);
  return panel && { panel, x: x - panel.x, y: y - panel.y, ratio };
}

function pixelAt({ panel, x, y }) {
  const [width, height] = data.images[panel.one].size ?? [1, 1];
  const { scale, origin } = place(panel);
  if (isRound()) {
    const point = pointOfSphere(x, y, SHAPES[view.shape], turnMatrix(view.yaw, view.pitch), panel, scale);
    return point && [Math.min(width - 1, Math.floor(point[0] * width)), Math.min(height - 1, Math.floor(point[1] * height))];
  }
  const at = [Math.floor((x - origin[0]) / scale), Math.floor((y - origin[1]) / scale)];
  return at[0] >= 0 && at[1] >= 0 && at[0] < width && at[1] < height ? at : null;
}

function zoomBy(factor, spot) {
  const panel = spot?.panel ?? view.layout[0];
  const { scale, origin } = place(panel);
  const next = Math.min(Math.max(scale * factor, isRound() ? 0.3 : 0.02), isRound() ? 20 : 256);
  if (isRound()) return set({ zoom: next });
  const [x, y] = spot ? [spot.x, spot.y] : [panel.width / 2, panel.height / 2];
  const [u, v] = [(x - origin[0]) / scale, (y - origin[1]) / scale];
  set({ zoom: next, x: u + (panel.width / 2 - x) / next, y: v + (panel.height / 2 - y) / next });
}

function panBy(dx, dy, panel = view.layout[0]) {
  const { scale } = place(panel);
  if (isRound()) {
    const factor = 2 / (Math.min(panel.width, panel.height) * scale) * (view.shape === "ball" ? 1 : -1);
    return set({ yaw: view.yaw - dx * factor, pitch: Math.min(1.57, Math.max(-1.57, view.pitch + dy * factor)) });
  }
  const [width, height] = data.images[view.ids[0]].size ?? [1, 1];
  set({ zoom: scale, x: (view.x ?? width / 2) - dx / scale, y: (view.y ?? height / 2) - dy / scale });
}

function listen(box) {
  const pointers = new Map();
  let isSplitting = false;
  box.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoomBy(2 ** (-event.deltaY / (event.deltaMode ? 12 : 400)), under(event));
  }, { passive: false });
  box.addEventListener("pointerdown", (event) => {
    const spot = under(event);
    if (!spot) return;
    box.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, event);
    isSplitting = view.mode === "split" && Math.abs(spot.x - view.split * spot.panel.width) < 12 * spot.ratio;
  });
  box.addEventListener("pointermove", (event) => {
    const spot = under(event);
    const last = pointers.get(event.pointerId);
    if (!last) {
      const pixel = spot && pixelAt(spot);
      if (pixel && String(pixel) !== String(view.pixel)) set({ pixel });
      return;
    }
    const ratio = view.canvas.width / box.getBoundingClientRect().width;
    if (pointers.size === 2) {
      const [other] = [...pointers.values()].filter((pointer) => pointer.pointerId !== event.pointerId);
      const far = (one) => Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY);
      zoomBy(far(event) / Math.max(1, far(last)), spot);
    } else if (isSplitting && spot) {
      set({ split: Math.min(1, Math.max(0, spot.x / spot.panel.width)) });
    } else {
      panBy((event.clientX - last.clientX) * ratio, (event.clientY - last.clientY) * ratio, spot?.panel);
    }
    pointers.set(event.pointerId, event);
  });
  for (const kind of ["pointerup", "pointercancel"]) box.addEventListener(kind, (event) => {
    const spot = under(event);
    pointers.delete(event.pointerId);
    const pixel = spot && pixelAt(spot);
    if (pixel) set({ pixel });
  });
}

const VIEWER_KEYS = {
  Escape: closeViewer,
  e: () => brighter(-0.5), E: () => brighter(0.5),
  s: () => set({ mode: "side" }), l: () => set({ mode: "split" }), f: () => set({ mode: "flip" }), d: () => set({ mode: "diff" }),
  D: () => set({ mode: "diff", diff: next(Object.keys(DIFFERENCES), view.diff) }),
  c: () => set({ color: next(Object.keys(FALSE), view.color) }),
  t: () => set({ operator: next(OPERATORS, view.operator) }),
  n: () => set({ flags: !view.flags }),
  m: () => set({ shape: next(Object.keys(SHAPES), view.shape), zoom: null }),
  0: () => set({ zoom: null, x: null, y: null }),
  "+": () => zoomBy(2), "=": () => zoomBy(2), "-": () => zoomBy(0.5),
  " ": () => set({ mode: "flip", current: (view.current + 1) % view.ids.length }),
  ",": () => set({ current: (view.current + view.ids.length - 1) % view.ids.length }),
  ".": () => set({ current: (view.current + 1) % view.ids.length }),
  ArrowLeft: (event) => step(event, -1, 0), ArrowRight: (event) => step(event, 1, 0), ArrowUp: (event) => step(event, 0, -1), ArrowDown: (event) => step(event, 0, 1),
};

function next(list, value) {
  return list[(list.indexOf(value) + 1) % list.length];
}

/** Moves the pixel that is looked at; with Shift, or on a ball, what is seen. */
function step(event, dx, dy) {
  const [width, height] = data.images[view.ids[0]].size ?? [1, 1];
  if (event.shiftKey || isRound()) return panBy(-40 * dx, -40 * dy);
  const [x, y] = view.pixel ?? [Math.floor(width / 2) - dx, Math.floor(height / 2) - dy];
  set({ pixel: [Math.min(width - 1, Math.max(0, x + dx)), Math.min(height - 1, Math.max(0, y + dy))] });
}

/** True if the key meant something. */
function viewerKey(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || event.target.closest("select, input")) return false;
  const digit = Number(event.key);
  if (digit >= 1 && digit <= 9 && digit <= view.ids.length) {
    set({ mode: view.mode === "split" ? "split" : "flip", current: digit - 1 });
    return true;
  }
  if (event.key === " " && event.target.closest("button")) return false;
  const act = VIEWER_KEYS[event.key];
  act?.(event);
  return Boolean(act);
}

// The address: only what differs from the start stands in it.

const ADDRESS_NUMBERS = ["ev", "dstops", "offset", "yaw", "pitch", "zoom", "x", "y", "split", "current"];
const ADDRESS_WORDS = { mode: MODES, diff: DIFFERENCES, shape: SHAPES, color: FALSE };

function keepAddress() {
  clearTimeout(view.addressTimer);
  const own = view;
  view.addressTimer = setTimeout(() => { if (view === own) history.replaceState(null, "", addressOf(own)); }, 150);
}

function addressOf(state) {
  const fields = ["view=" + state.ids.map((id) => encodeURIComponent(data.images[id].place)).join("+")];
  const add = (key, value) => fields.push(key + "=" + encodeURIComponent(value));
  if (state.reference != null) add("reference", data.images[state.reference].place);
  for (const key of Object.keys(ADDRESS_WORDS)) if (state[key] !== START[key]) add(key, state[key]);
  for (const key of ADDRESS_NUMBERS) if (state[key] !== START[key]) add(key, Number(state[key].toPrecision(7)));
  if (state.operator !== START.operator) add("operator", state.operator);
  if (state.gamma !== START.gamma) add("gamma", state.gamma);
  if (!state.flags) add("flags", "off");
  if (state.marks >= 0) add("marks", data.marks[state.marks].place);
  if (state.pixel) add("pixel", state.pixel.join(","));
  return "#" + fields.join("&");
}

/** Opens what an address names; false if it names nothing of this page. */
function openAddress(hash) {
  const decode = (text) => { try { return decodeURIComponent(text); } catch { return ""; } };
  const pairs = hash.replace(/^#/, "").split("&").map((field) => { const cut = field.indexOf("="); return [field.slice(0, cut), field.slice(cut + 1)]; });
  const raw = new Map(pairs);
  if (!raw.has("view")) return false;
  const ids = raw.get("view").split("+").map((text) => byPlace.get(decode(text))).filter((id) => id !== undefined);
  if (!ids.length) return false;
  const given = { ev: 0 };
  for (const key of ADDRESS_NUMBERS) if (raw.has(key) && Number.isFinite(Number(raw.get(key)))) given[key] = Number(raw.get(key));
  for (const [key, words] of Object.entries(ADDRESS_WORDS)) if (Object.hasOwn(words, raw.get(key) ?? "")) given[key] = raw.get(key);
  if (OPERATORS.includes(raw.get("operator"))) given.operator = raw.get("operator");
  if (Number(raw.get("gamma")) > 0) given.gamma = raw.get("gamma");
  if (raw.get("flags") === "off") given.flags = false;
  given.reference = byPlace.get(decode(raw.get("reference") ?? "")) ?? null;
  const marks = data.marks.findIndex((marks) => marks.place === decode(raw.get("marks") ?? ""));
  if (marks >= 0) given.marks = marks;
  const pixel = decode(raw.get("pixel") ?? "").split(",").map(Number);
  if (pixel.length === 2 && pixel.every(Number.isInteger)) given.pixel = pixel;
  given.current = Math.min(Math.max(0, Math.floor(given.current ?? 0)), ids.length - 1);
  openViewer(ids, given);
  return true;
}
