// Tables that are sorted by a click on a column: numbers as numbers, times as times, empty cells last.

const UNITS = { "µs": 1e-6, ms: 1e-3, s: 1, min: 60, h: 3600 };

function sortKey(cell) {
  const text = (cell.getAttribute("title") ?? cell.textContent).trim();
  if (text === "") return null;
  const number = Number(text);
  if (!Number.isNaN(number)) return number;
  const parts = [...text.matchAll(/([\d.]+) (µs|ms|s|min|h)\b/g)];
  if (parts.length && parts.map((part) => part[0]).join(" ") === text) return parts.reduce((sum, part) => sum + part[1] * UNITS[part[2]], 0);
  return text;
}

function compared(one, other) {
  if (one === null || other === null) return one === other ? 0 : one === null ? 1 : -1;
  if (typeof one === "number" && typeof other === "number") return one - other;
  return String(one) < String(other) ? -1 : String(one) > String(other) ? 1 : 0;
}

function makeSortable(table) {
  const heads = [...table.tHead.rows[0].cells];
  heads.forEach((head, column) => {
    const button = make("button", { type: "button", title: "Sort" });
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const isUp = head.getAttribute("aria-sort") !== "ascending";
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", isUp ? "ascending" : "descending");
      const rows = [...table.tBodies[0].rows].map((row) => ({ row, key: sortKey(row.cells[column]) }));
      rows.sort((one, other) => (isUp || one.key === null || other.key === null ? 1 : -1) * compared(one.key, other.key));
      table.tBodies[0].append(...rows.map((entry) => entry.row));
    });
  });
}
