// wall times stand in timings.js beside the page, so that the page itself is the same for the same jobs
if (typeof TIMINGS !== "undefined") for (const cell of document.querySelectorAll("[data-wall]")) {
  const seconds = TIMINGS[cell.dataset.wall];
  if (typeof seconds === "number") cell.textContent = seconds.toFixed(1);
}
for (const head of document.querySelectorAll("th")) {
  head.style.cursor = "pointer";
  head.title = "sort";
  head.tabIndex = 0;
  head.addEventListener("keydown", evt => { if (evt.key === "Enter" || evt.key === " ") { evt.preventDefault(); head.click(); } });
  head.addEventListener("click", () => {
    const column = [...head.parentNode.children].indexOf(head), body = head.closest("table").tBodies[0];
    const key = row => {
      const text = row.cells[column].textContent.trim().replace("−", "-"), number = parseFloat(text);
      return Number.isNaN(number) ? [1, text] : [0, number];
    };
    const sign = head.dataset.sign = head.dataset.sign === "1" ? -1 : 1;
    for (const other of head.parentNode.children) other.removeAttribute("aria-sort");
    head.setAttribute("aria-sort", sign > 0 ? "ascending" : "descending");
    const rows = [...body.rows].map((row, n) => [key(row), n, row]);
    rows.sort(([[a, x], m], [[b, y], n]) => a - b || sign * (x < y ? -1 : x > y ? 1 : 0) || m - n);
    body.append(...rows.map(r => r[2]));
  });
}
