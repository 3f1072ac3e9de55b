// What the scripts of test_pages_in_browser.py share: pointer events within a plot, and the pixels of its canvas.
const wait = ms => new Promise(done => setTimeout(done, ms));
const at = (u, x, y) => { const b = u.over.getBoundingClientRect(); return { clientX: b.left + x * b.width, clientY: b.top + y * b.height, bubbles: true, button: 0, movementX: 1, movementY: 1 }; };
const send = (u, kind, x, y) => u.over.dispatchEvent(new MouseEvent(kind, at(u, x, y)));
const ink = u => {
  const c = u.ctx.canvas, d = u.ctx.getImageData(0, 0, c.width, c.height).data, seen = {};
  for (let i = 0; i < d.length; i += 4) if (d[i + 3]) seen[[d[i], d[i + 1], d[i + 2]]] = (seen[[d[i], d[i + 1], d[i + 2]]] || 0) + 1;
  return seen;
};
const total = u => Object.values(ink(u)).reduce((a, b) => a + b, 0);
const of = id => PLOTS.find(u => u.root.parentNode.id === id);
const span = u => [u.scales.x.min, u.scales.x.max];
const gone = u => u.series.findIndex((s, i) => i && !s.show);
const ofColour = (u, i) => {  // pixels in the very colour of a series: axes are drawn anew without it, so all ink may grow
  const s = u.series[i], c = u.ctx;
  if (!s.stroke) return 0;
  c.save(); c.fillStyle = typeof s.stroke === "function" ? s.stroke(u, i) : s.stroke;
  const hex = c.fillStyle; c.restore();
  return ink(u)[[1, 3, 5].map(k => parseInt(hex.slice(k, k + 2), 16))] || 0;
};
