const body = document.querySelector("tbody");
const rows = Array.from(body.rows);
const heads = Array.from(document.querySelectorAll("thead th"));
const search = document.querySelector("input[type=search]");
const filters = Array.from(document.querySelectorAll("[data-filter]"));
const shown = document.getElementById("shown");
let filter = "all";

function value(row, column, numeric) {
  const text = row.cells[column].dataset.value ?? row.cells[column].textContent.trim();
  return numeric ? (text === "" ? NaN : Number(text)) : text.toLowerCase();
}

// Rows without a number come last in both directions.
function order(a, b, numeric) {
  if (!numeric) return a < b ? -1 : a > b ? 1 : 0;
  return a - b;
}

function sort(column) {
  const head = heads[column];
  const numeric = head.classList.contains("number");
  const down = head.getAttribute("aria-sort") === "ascending";
  heads.forEach((other) => other.removeAttribute("aria-sort"));
  head.setAttribute("aria-sort", down ? "descending" : "ascending");
  const keyed = rows.map((row, i) => [value(row, column, numeric), i, row]);
  keyed.sort(([a, i], [b, j]) => {
    if (numeric && (Number.isNaN(a) || Number.isNaN(b))) {
      return Number.isNaN(a) - Number.isNaN(b) || i - j;
    }
    return (down ? -order(a, b, numeric) : order(a, b, numeric)) || i - j;
  });
  body.append(...keyed.map(([, , row]) => row));
}

function show() {
  const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
  let count = 0;
  for (const row of rows) {
    const fits = filter === "all" || row.dataset.kind === filter;
    const text = row.dataset.text;
    row.hidden = !(fits && words.every((word) => text.includes(word)));
    count += !row.hidden;
  }
  shown.textContent = `${count} of ${rows.length} shown`;
  filters.forEach((b) => b.setAttribute("aria-pressed", String(b.dataset.filter === filter)));
}

heads.forEach((head, i) => head.querySelector("button")?.addEventListener("click", () => sort(i)));
filters.forEach((button) => button.addEventListener("click", () => {
  filter = button.dataset.filter;
  show();
}));
search.addEventListener("input", show);
show();
