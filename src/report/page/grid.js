// The image grid: axes become rows, columns and sliders, as the reader likes.

const markedImages = new Set();
let tray = null;

function showTray() {
  tray?.remove();
  tray = null;
  if (markedImages.size === 0) return;
  const count = markedImages.size === 1 ? "1 image" : markedImages.size + " images";
  tray = make("div", { class: "tray", role: "status" }, make("span", {}, count),
    make("button", { type: "button", class: "primary", onclick: () => openViewer([...markedImages]) }, markedImages.size > 1 ? "Compare" : "Open"),
    make("button", { type: "button", onclick: unmarkAll }, "Clear"));
  document.body.append(tray);
}

function setMarked(id, isMarked) {
  if (isMarked) markedImages.add(id);
  else markedImages.delete(id);
  const figure = document.getElementById("image-" + id);
  figure?.classList.toggle("marked", isMarked);
  const box = figure?.querySelector(".mark input");
  if (box) box.checked = isMarked;
  showTray();
}

function unmarkAll() {
  [...markedImages].forEach((id) => setMarked(id, false));
}

function prepareShot(figure) {
  const id = Number(figure.dataset.image);
  const image = data.images[id];
  const preview = figure.firstElementChild;
  const button = make("button", { type: "button", class: "open", title: "Show the pixels of " + image.place, onclick: () => openViewer([id]) });
  preview.replaceWith(button);
  button.append(preview);
  const caption = figure.querySelector("figcaption");
  if (!figure.classList.contains("shot")) return;
  const box = make("input", { type: "checkbox", "aria-label": "Mark " + image.place, onchange: (event) => setMarked(id, event.target.checked) });
  const text = caption.firstChild;
  const label = make("label", { class: "mark" }, box);
  text.replaceWith(label);
  label.append(make("span", { class: "what" }, text));
  const files = caption.querySelector(".files") ?? caption.appendChild(make("span", { class: "files" }));
  files.append(make("button", { type: "button", class: "job", title: "Where it comes from", onclick: () => showJob(image.job) }, "info"));
}

function groupedBy(items, key) {
  const groups = new Map();
  for (const item of items) {
    const name = key(item);
    if (!groups.has(name)) groups.set(name, []);
    groups.get(name).push(item);
  }
  return groups;
}

/** Images of a group beyond this are reached by sliders. */
const SHOWN_AT_ONCE = 240;

/** Values of an axis among images, in order of appearance. */
function valuesOf(ids, axis) {
  return [...new Set(ids.map((id) => data.images[id].at[axis] ?? ""))];
}

function prepareGroup(section) {
  const shots = section.querySelector(".shots");
  const figures = [...shots.children];
  const ids = figures.map((figure) => Number(figure.dataset.image));
  const group = data.groups[data.images[ids[0]].group];
  const values = Object.fromEntries(group.axes.map((axis) => [axis, valuesOf(ids, axis)]));
  const axes = group.axes.filter((axis) => values[axis].length > 1);
  if (ids.length < 2) return figures.forEach(prepareShot);
  const isLarge = ids.length > SHOWN_AT_ONCE;
  const flow = isLarge ? axes.findLast((axis) => values[axis].length <= SHOWN_AT_ONCE) : null;
  const figureAt = new Map(ids.map((id, index) => [id, figures[index]]));
  const prepared = new Set();
  const figureOf = (id) => {
    if (!prepared.has(id)) prepareShot(figureAt.get(id));
    prepared.add(id);
    return figureAt.get(id);
  };
  const isTable = axes.length > 1 && !isLarge;
  const state = { rows: isTable ? axes[0] : "", columns: isTable ? axes[1] : "", at: {} };
  const controls = make("div", { class: "controls" });
  shots.before(controls);

  /** Axes that are neither rows nor columns; in a large group one of them is laid out in a row. */
  const sliders = () => {
    const isFree = !state.rows && !state.columns;
    if (isFree && !isLarge) return [];
    return axes.filter((axis) => axis !== state.rows && axis !== state.columns && !(isFree && axis === flow));
  };
  const shownIds = () => {
    const fixed = sliders().map((axis) => [axis, values[axis][state.at[axis] ?? 0]]);
    return ids.filter((id) => fixed.every(([axis, value]) => (data.images[id].at[axis] ?? "") === value));
  };

  const arrange = () => {
    const shown = shownIds();
    figures.forEach((figure) => figure.remove());
    if (!state.rows && !state.columns) {
      shots.className = "shots";
      shots.replaceChildren(...shown.map(figureOf));
      return;
    }
    const rows = state.rows ? values[state.rows] : [null];
    const columns = state.columns ? values[state.columns] : [null];
    const table = make("table");
    if (state.columns) {
      const heads = columns.map((value) => make("th", { scope: "col" }, state.columns + " = " + value));
      table.append(make("thead", {}, make("tr", {}, state.rows ? make("td") : null, ...heads)));
    }
    const body = make("tbody");
    const placeOf = (id) => JSON.stringify([state.rows, state.columns].map((axis) => (axis ? (data.images[id].at[axis] ?? "") : null)));
    const cellsAt = groupedBy(shown, placeOf);
    for (const row of rows) {
      const cells = columns.map((column) => make("td", {}, ...(cellsAt.get(JSON.stringify([row, column])) ?? []).map(figureOf)));
      body.append(make("tr", {}, state.rows ? make("th", { scope: "row" }, state.rows + " = " + row) : null, ...cells));
    }
    table.append(body);
    shots.className = "matrix";
    shots.replaceChildren(table);
  };

  const choice = (name, key, otherKey) => {
    const options = ["", ...axes].map((axis) => make("option", { value: axis, selected: axis === state[key] }, axis || "none"));
    const select = make("select", { onchange: (event) => {
      if (event.target.value && event.target.value === state[otherKey]) state[otherKey] = state[key];
      state[key] = event.target.value;
      build();
    } }, ...options);
    return make("label", {}, name, select);
  };

  const slider = (axis) => {
    const output = make("output", {}, values[axis][state.at[axis] ?? 0]);
    const input = make("input", { type: "range", min: 0, max: values[axis].length - 1, value: state.at[axis] ?? 0, "aria-label": axis, oninput: (event) => {
      state.at[axis] = Number(event.target.value);
      output.textContent = values[axis][state.at[axis]];
      input.setAttribute("aria-valuetext", output.textContent);
      arrange();
    } });
    input.setAttribute("aria-valuetext", output.textContent);
    return make("label", {}, axis, input, output);
  };

  const build = () => {
    controls.replaceChildren(
      ...(axes.length ? [choice("rows", "rows", "columns"), choice("columns", "columns", "rows"), ...sliders().map(slider)] : []),
      make("button", { type: "button", onclick: () => openViewer(shownIds().slice(0, 16)) }, "Compare these"),
    );
    arrange();
  };
  build();
}

/** Groups come to life when they are about to be seen: a page may have thousands of images. */
function prepareGroups() {
  const observer = new IntersectionObserver((entries) => {
    for (const entry of entries.filter((entry) => entry.isIntersecting)) {
      observer.unobserve(entry.target);
      prepareGroup(entry.target);
    }
  }, { rootMargin: "800px" });
  document.querySelectorAll(".group").forEach((group) => observer.observe(group));
}
