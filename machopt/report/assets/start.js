const DATA = JSON.parse(document.getElementById("data").textContent);
for (const spec of DATA.charts) lineChart(document.getElementById(spec.id), spec);
if (DATA.rotation) {
  const [phi, gamma] = ["phi", "gamma"].map(name => new Float32Array(bytes(DATA.rotation[name]).buffer));
  const angle = v => Number.isFinite(v) ? minus(`${(Math.abs(v) < 0.05 ? 0 : v).toFixed(1)}°`) : "–";
  rotationAtPoint = point => [["φ, γ", `${angle(phi[point])}, ${angle(gamma[point])}`]];
}
if (DATA.map) heatMap(document.getElementById("map"), DATA.map);
const VIEW = DATA.view ? robotView(document.getElementById("view"), DATA) : null;
