const DATA = JSON.parse(document.getElementById("data").textContent);
for (const spec of DATA.charts) lineChart(document.getElementById(spec.id), spec);
const VIEW = DATA.view ? postureView(document.getElementById("view"), DATA.view) : null;
if (DATA.field) fieldMap(document.getElementById("field"), DATA.field, VIEW && DATA.view.around ? standAt(VIEW, DATA.view, DATA.field) : null);
if (DATA.arms) {
  const all = DATA.arms.q.map(q => armPoints(DATA.arms.arm, q)), n = all.length;
  const postures = all.map((points, i) => ({ points, color: "#1b2430", opacity: 0.25 + 0.75 * i / Math.max(1, n - 1) }));
  const svg = armViews(DATA.arms.arm, all)(postures, DATA.arms.line.length ? DATA.arms.line : null);
  svg.style.maxWidth = "520px";
  document.getElementById("arms").replaceChildren(svg);
}
