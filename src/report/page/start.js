// Puts life into the page: jobs that tell where they come from, themes, keys.

function dialog(title, ...content) {
  const made = make("dialog", { "aria-label": title, onclick: (event) => { if (event.target === made) made.close(); }, onclose: () => made.remove() },
    make("header", {}, make("h2", {}, title), make("button", { type: "button", onclick: () => made.close() }, "Close")), ...content);
  document.body.append(made);
  made.showModal();
}

async function copy(text, button) {
  try {
    await navigator.clipboard.writeText(text);
  } catch {
    const area = make("textarea", { readonly: true });
    area.value = text;
    (button.closest("dialog") ?? document.body).append(area);
    area.select();
    document.execCommand("copy");
    area.remove();
  }
  button.textContent = "Copied";
  setTimeout(() => { button.textContent = "Copy"; }, 1500);
}

function command(text) {
  const button = make("button", { type: "button", onclick: () => copy(text, button) }, "Copy");
  return make("p", { class: "command" }, make("code", {}, text), button);
}

function sizeText(bytes) {
  for (const unit of ["B", "KiB", "MiB"]) {
    if (bytes < 1024) return (unit === "B" ? bytes : bytes.toFixed(1)) + " " + unit;
    bytes /= 1024;
  }
  return bytes.toFixed(1) + " GiB";
}

/** A parameter as YAML would have it in one line. */
function parameterText(value) {
  return typeof value === "string" ? value : JSON.stringify(value);
}

/** Where a result comes from, and the command that makes it again. */
function showJob(index) {
  const job = data.jobs[index];
  const rows = [];
  const row = (term, ...content) => rows.push(make("dt", {}, term), make("dd", {}, ...content));
  const list = (items) => make("ul", {}, ...items.map((item) => make("li", {}, ...item)));
  const link = (text, target) => (target == null ? text : make("button", { type: "button", class: "job", onclick: (event) => { event.target.closest("dialog").close(); showJob(target); } }, text));
  row("kind", job.kind);
  row("outcome", job.outcome, job.reason ? " (" + job.reason + ")" : "", job.time ? ", " + job.time : "");
  if (job.error) row("error", make("strong", { class: "remark" }, job.error));
  if (job.parameters) row("parameters", list(Object.entries(job.parameters).map(([name, value]) => [make("code", {}, name + ": " + parameterText(value))])));
  if (job.seed != null) row("seed", String(job.seed));
  if (job.inputs) {
    const shown = job.inputs.slice(0, 40).map(([port, place, target]) => [make("span", { class: "quiet" }, port + " "), link(place, target)]);
    if (job.inputs.length > 40) shown.push([`and ${job.inputs.length - 40} more`]);
    row("inputs", list(shown));
  }
  if (job.read) row("files read", list(job.read.map(([name, path, digest]) => [make("span", { class: "quiet" }, name + " "), path, make("br"), make("code", { class: "digest" }, digest)])));
  if (job.warnings) row("warnings", list(job.warnings.map((text) => [text])));
  if (job.outputs) row("results", list(job.outputs.map(([name, type, digest, bytes, files]) => [
    (name || "(first)") + ", " + type + ", " + sizeText(bytes), make("br"), make("code", { class: "digest" }, digest),
    ...files.flatMap(([path, address]) => [make("br"), address ? make("a", { href: address }, path) : path]),
  ])));
  if (job.key) row("key", make("code", { class: "digest" }, job.key));
  row("make it again", command(data.run.command + " " + job.only));
  dialog(job.place, make("dl", { class: "detail" }, ...rows));
}

function showKeys() {
  const keys = [
    ["1 … 9", "show one of the images in place of the others"], ["space", "flip to the next image"], [", .", "previous and next image"],
    ["s l f d", "side by side, split, flip, difference"], ["D", "signed, absolute, relative difference"],
    ["e E", "half a stop darker, brighter"], ["t", "next tone curve"], ["c", "false color"], ["n", "mark NaN, infinite and negative pixels"],
    ["m", "map flat, as a ball, from inside"], ["+ − 0", "zoom in, out, fit"], ["arrows", "move the pixel that is looked at; with Shift, the image"],
    ["wheel, drag", "zoom, pan or turn"], ["Escape", "close"],
  ];
  dialog("Keys of the viewer", make("dl", { class: "keys" }, ...keys.flatMap(([key, text]) => [make("dt", {}, make("kbd", {}, key)), make("dd", {}, text)])),
    make("p", { class: "quiet" }, "The address always says what is shown: copy it to show it to others."));
}

const THEMES = ["auto", "light", "dark"];

function setTheme(theme) {
  if (theme === "auto") delete document.documentElement.dataset.theme;
  else document.documentElement.dataset.theme = theme;
  const button = document.getElementById("theme");
  button.textContent = { auto: "◐", light: "○", dark: "●" }[theme];
  button.title = "Theme: " + theme;
  try { sessionStorage.setItem("theme", theme); } catch { /* Some browsers forbid it to pages from a disk. */ }
}

function start() {
  document.querySelectorAll(".script-only, .tools").forEach((element) => { element.hidden = false; });
  document.getElementById("keys").addEventListener("click", showKeys);
  let theme = "auto";
  try { theme = sessionStorage.getItem("theme") ?? "auto"; } catch { /* As above. */ }
  setTheme(THEMES.includes(theme) ? theme : "auto");
  document.getElementById("theme").addEventListener("click", () => setTheme(next(THEMES, document.documentElement.dataset.theme ?? "auto")));

  prepareGroups();
  document.querySelectorAll(".sheet").forEach(prepareShot);
  document.querySelectorAll("table[data-sort]").forEach(makeSortable);
  document.querySelectorAll(".summary .command").forEach((place) => place.replaceWith(command(data.run.command)));
  document.querySelectorAll("span.job[data-job]").forEach((span) => {
    span.replaceWith(make("button", { type: "button", class: "job", "data-job": span.dataset.job }, ...span.childNodes));
  });
  document.addEventListener("click", (event) => {
    const target = event.target.closest?.("button.job[data-job], rect[data-job]");
    if (target) showJob(Number(target.dataset.job));
  });
  document.addEventListener("keydown", (event) => {
    if (document.querySelector("dialog[open]")) return;
    if (event.key === "?" && !event.target.closest("input, select")) showKeys();
    else if (view && viewerKey(event)) event.preventDefault();
  });
  addEventListener("hashchange", () => openAddress(location.hash));
  openAddress(location.hash);
  document.documentElement.dataset.ready = "yes";
}

start();
