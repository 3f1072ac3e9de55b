// Charts by uPlot: what machopt adds is the tooltip, shaded operations, limits and marks. Drag to zoom, double click to see all.
const FONT = 'system-ui, -apple-system, "Segoe UI", Roboto, "Liberation Sans", Arial, sans-serif';
const LIMIT_COLOR = "#b3261e";
const PLOTS = [];

// Colours of the page's style sheet; on a dark screen lines go over to lighter tones of their own colour.
const screenDark = window.matchMedia("(prefers-color-scheme: dark)");
let dark = false, TICK, RULE, AXIS, BOX, BAND, PAPER, LIMIT;
const LIGHTER = { "#1552b8": "#74a9ff", "#d9730d": "#f59a45", "#7a8490": "#a3aebb", "#2c8a57": "#55bd8b", "#b3261e": "#ff7b72", "#1b2430": "#dfe5ec", "#222": "#dfe5ec", "#8a3fb0": "#c792ea", "#8e44ad": "#c792ea", "#5b6673": "#a3aebb" };
const tone = color => dark && LIGHTER[color] || color;

function readColors(paper = false) {
  dark = screenDark.matches && !paper;
  document.documentElement.classList.toggle("dark", dark);
  const style = getComputedStyle(document.documentElement), of = name => style.getPropertyValue(name).trim();
  [TICK, RULE, AXIS, BOX, BAND, PAPER] = ["--tick", "--grid", "--axis", "--box", "--band", "--paper"].map(of);
  LIMIT = tone(LIMIT_COLOR);
}

function recolor(paper = false) {
  readColors(paper);
  for (const u of PLOTS) { // the legend has no row for x
    u.root.querySelectorAll(".u-legend .u-series").forEach((row, k) => { const m = row.querySelector(".u-marker"), s = u.series[k + 1]; if (m && s && s.tint) m.style.borderColor = tone(s.tint); });
    u.redraw(false, true);
  }
}

readColors();
screenDark.addEventListener("change", () => recolor());
// On paper: dark on white, and where a page is to be brief its pictures are drawn anew in the size they have there.
window.addEventListener("beforeprint", () => {
  readColors(true);
  if (document.body.classList.contains("brief")) for (const u of PLOTS) {
    const place = u.root.parentNode, share = place.closest(".grid3") ? 3 : place.closest(".grid2") ? 2 : 1;
    u.before = [u.width, u.height];
    u.setSize({ width: Math.round(1080 / share) - 12, height: Math.round(u.height * (share === 3 ? 0.72 : 0.66)) });
  }
  recolor(true);
});
window.addEventListener("afterprint", () => {
  for (const u of PLOTS) if (u.before) { u.setSize({ width: u.before[0], height: u.before[1] }); delete u.before; }
  recolor();
});

// The place the robot stands at, marked in every picture that shares its axis; who sets it says so to all (see view.js).
const HERE = { path: null, station: null, time: null, phi: null };
let onPick = null, rotationAtTime = null, rotationAtPoint = null;

function markHere(u) {
  const at = HERE[u.axisOf], box = u.over;
  if (!u.here) { u.here = document.createElement("div"); u.here.className = "here"; box.appendChild(u.here); }
  const x = at === null || at === undefined ? NaN : u.valToPos(at, "x");
  u.here.style.display = x >= 0 && x <= box.clientWidth ? "block" : "none";
  u.here.style.left = `${x}px`;
  if (u.height2) { u.here.style.setProperty("--y", HERE.phi === null ? "-99px" : `${u.valToPos(HERE.phi, "y")}px`); }
}

function moveHere(place) {
  Object.assign(HERE, place);
  for (const u of PLOTS) if (u.axisOf) markHere(u);
}

const tip = document.createElement("div");
tip.className = "tip";
(document.querySelector("main") || document.body).appendChild(tip);

function showTip(evt, rows) {
  tip.replaceChildren();
  for (const [name, value, color] of rows) {
    const row = document.createElement("div"), a = document.createElement("span"), b = document.createElement("b");
    if (color) { const s = document.createElement("i"); s.style.background = color; row.appendChild(s); }
    a.textContent = name; b.textContent = value;
    row.append(a, b);
    tip.appendChild(row);
  }
  tip.style.display = "block";
  const w = tip.offsetWidth, h = tip.offsetHeight;
  const left = evt.clientX + 16 + w > window.innerWidth ? evt.clientX - 16 - w : evt.clientX + 16;
  tip.style.left = Math.max(4, left) + window.scrollX + "px";
  tip.style.top = Math.max(4, Math.min(evt.clientY + 12, window.innerHeight - h - 8)) + window.scrollY + "px";
}

const hideTip = () => { tip.style.display = "none"; };
const minus = text => text.replaceAll("-", "−");

// Numbers of an axis with as many decimals as its steps need.
function plain(u, values, axis, space, step) {
  let d = 0;
  while (d < 9 && Math.abs(step * 10 ** d - Math.round(step * 10 ** d)) > 1e-6) d++;
  return values.map(v => minus((v + 0).toFixed(d)));
}

function logTicks(lo, hi) {
  const out = [], decades = Math.log10(hi / lo), steps = decades > 2.5 ? [1] : decades > 0.9 ? [1, 2, 5] : [1, 1.5, 2, 3, 4, 5, 6, 8];
  for (let e = Math.floor(Math.log10(lo)); e <= Math.log10(hi); e++) for (const m of steps) { const v = m * 10 ** e; if (v >= lo && v <= hi) out.push(v); }
  return out;
}

const short = v => v >= 1e4 || v < 1e-2 ? v.toExponential(1).replace("e+", "e").replace(".0", "") : String(+v.toPrecision(3));

// One side's axis; `log` scales and named places get ticks of their own.
function axis(side, label, { grid = true, log = false, names = null, size = side % 2 ? 46 : 22, ...more } = {}) {
  const given = log ? { splits: (u, k, lo, hi) => logTicks(lo, hi), filter: (u, at) => at, values: (u, at) => at.map(short) } : {};
  if (names) given.splits = u => {
    const every = side % 2 ? 1 : Math.ceil(names.length * 32 / (u.width - 64));
    return names.map((_, i) => i).filter(i => i % every === 0);
  };
  if (names) given.values = (u, at) => at.map(i => names[i]);
  return {
    side, label: label || null, labelSize: label ? 18 : 0, labelGap: 0, size, gap: 4, font: `11px ${FONT}`, labelFont: `12px ${FONT}`,
    stroke: () => TICK, grid: { show: grid, stroke: () => RULE, width: 1 }, ticks: { size: 4, stroke: () => AXIS, width: 1 }, values: plain,
    space: side % 2 ? 34 : 80, ...given, ...more,
  };
}

// A uPlot in its place: as wide as that is; on paper the style sheet narrows it.
function plot(host, opts, data) {
  const u = new uPlot({ ...opts, width: opts.width || Math.max(260, host.clientWidth) }, data, host);
  if (!opts.width) {
    PLOTS.push(u);
    new ResizeObserver(() => { if (host.clientWidth && host.clientWidth !== u.width) u.setSize({ width: host.clientWidth, height: u.height }); }).observe(host);
  }
  u.over.addEventListener("mouseleave", hideTip);
  if (opts.axisOf) {
    u.axisOf = opts.axisOf;
    u.height2 = opts.height2;
    (u.hooks.draw = u.hooks.draw || []).push(markHere);
    markHere(u);
  }
  if (opts.pick) { // a click, and no end of a drag
    let down = null;
    u.over.addEventListener("mousedown", evt => { down = [evt.clientX, evt.clientY]; });
    u.over.addEventListener("click", evt => { if (onPick && down && Math.hypot(evt.clientX - down[0], evt.clientY - down[1]) < 4) onPick(opts.pick(u, evt)); });
  }
  return u;
}

window.addEventListener("beforeprint", () => document.querySelectorAll(".full details").forEach(d => { d.open = true; }));

// Where the pointer is in a plot, in its pixels.
function under(u, evt) {
  const box = u.over.getBoundingClientRect();
  return [evt.clientX - box.left, evt.clientY - box.top];
}

// Draws in pixels of the page within the plot, or around it too.
function paint(u, draw, { clip = true } = {}) {
  const { ctx, bbox } = u, r = uPlot.pxRatio;
  ctx.save();
  ctx.scale(r, r);
  const box = { x: bbox.left / r, y: bbox.top / r, w: bbox.width / r, h: bbox.height / r };
  if (clip) { ctx.beginPath(); ctx.rect(box.x, box.y, box.w, box.h); ctx.clip(); }
  draw(ctx, box, v => u.valToPos(v, "x", true) / r, v => u.valToPos(v, "y", true) / r);
  ctx.restore();
}

// Names beside an axis: how wide the longest is, and those too long for a quarter of a narrow page shortened.
const PEN = document.createElement("canvas").getContext("2d");
const wide = text => { PEN.font = `11px ${FONT}`; return PEN.measureText(text).width; };
const roomy = names => Math.max(46, ...names.map(wide)) + 10;
const fitting = name => { if (wide(name) <= 110) return name; let n = name.length; while (n > 1 && wide(name.slice(0, n) + "…") > 110) n--; return name.slice(0, n) + "…"; };

function write(ctx, text, x, y, color, align, size = 11) {
  ctx.font = `${size}px ${FONT}`; ctx.fillStyle = color; ctx.textAlign = align; ctx.textBaseline = "alphabetic";
  ctx.fillText(text, x, y);
}

function rule(ctx, x0, y0, x1, y1, color, dash = [], width = 1) {
  ctx.strokeStyle = color; ctx.lineWidth = width; ctx.setLineDash(dash);
  ctx.beginPath(); ctx.moveTo(x0, y0); ctx.lineTo(x1, y1); ctx.stroke();
}

const edge = u => paint(u, (ctx, b) => { ctx.strokeStyle = BOX; ctx.strokeRect(b.x, b.y, b.w, b.h); }, { clip: false });
const dashes = text => text ? text.split(" ").map(Number) : [];

function legend(entries, show) {
  const of = k => entries[k - 1];
  return { show, live: false, markers: { width: 2, stroke: (u, k) => tone(of(k).color), fill: (u, k) => of(k).type === "points" && !of(k).hollow ? tone(of(k).color) : null, dash: (u, k) => of(k).dash ? "dashed" : "solid" } };
}

// Runs too short to be seen as lines, which get a dot: the holes of a drilling job.
function dots(u, x, y) {
  const out = [], known = k => y[k] !== null && y[k] !== undefined, px = k => u.valToPos(x[k], "x");
  for (let k = 0, first = -1; k <= x.length; k++) {
    if (k < x.length && known(k)) { if (first < 0) first = k; continue; }
    if (first >= 0 && px(k - 1) - px(first) < 3) out.push(first);
    first = -1;
  }
  return out;
}

function lineChart(host, spec) {
  const range = (u, lo, hi) => {
    lo = Math.min(lo ?? Infinity, spec.ymin ?? Infinity); hi = hi ?? -Infinity;
    for (const l of spec.hlines || []) if (l.fit) { lo = Math.min(lo, l.y); hi = Math.max(hi, l.y); }
    if (lo > hi) return [0, 1];
    const pad = (hi - lo || Math.abs(hi) || 1) * 0.06;
    return [spec.ymin === undefined ? lo - pad : lo, hi + pad];
  };
  const shade = u => paint(u, (ctx, b, X) => {
    (spec.bands || []).forEach((band, i) => {
      const from = Math.max(X(band.from), b.x), to = Math.min(X(band.to), b.x + b.w);
      if (from >= to) return;
      if (i % 2) { ctx.fillStyle = BAND; ctx.fillRect(from, b.y, to - from, b.h); }
      if (to - from > 6.2 * band.label.length + 4) write(ctx, band.label, (from + to) / 2, b.y - 6, TICK, "center");
    });
  }, { clip: false });
  const mark = u => paint(u, (ctx, b, X, Y) => {
    for (const l of spec.hlines || []) {
      rule(ctx, b.x, Y(l.y), b.x + b.w, Y(l.y), LIMIT, [6, 4], 1.1);
    }
    ctx.fillStyle = LIMIT;
    for (const m of spec.marks || []) { const x = X(m.x); ctx.beginPath(); ctx.moveTo(x, b.y + 11); ctx.lineTo(x - 5, b.y + 1); ctx.lineTo(x + 5, b.y + 1); ctx.fill(); }
  });
  const named = (spec.hlines || []).filter(l => l.label); // beside the plot, where neither curve nor cursor runs over them
  const name = u => paint(u, (ctx, b, X, Y) => { for (const l of named) write(ctx, l.label, b.x + b.w + 4, Y(l.y) + 4, LIMIT, "left"); }, { clip: false });
  const places = (spec.extra || []).find(e => e.name === "point");
  const pick = spec.group === "time" ? (u, evt) => ({ kind: "time", time: u.posToVal(under(u, evt)[0], "x") })
    : places ? (u, evt) => ({ kind: "point", point: places.names[places.at[u.posToIdx(under(u, evt)[0])]] }) : null;
  const u = plot(host, {
    axisOf: spec.group, pick,
    title: spec.title, height: spec.height || 230, padding: [spec.labels ? 20 : 8, named.length ? 44 : 14, spec.xlabel ? 0 : 4, spec.ylabel ? 0 : 4],
    legend: legend(spec.series, spec.series.length > 1 && spec.legend !== false),
    cursor: { sync: { key: spec.group, setSeries: false, scales: ["x", null] }, drag: { x: true, y: false }, points: { size: 6 } },
    scales: { x: { time: false }, y: { range } },
    axes: [axis(2, spec.xlabel, { grid: false }), axis(3, spec.ylabel)],
    series: [{}, ...spec.series.map(s => ({ label: s.name, tint: s.color, stroke: () => tone(s.color), width: s.width || 1.6, dash: s.dash ? dashes(s.dash) : undefined, points: { show: true, filter: u => dots(u, spec.x, s.y), size: 4, width: 0, fill: () => tone(s.color) } }))],
    hooks: { drawClear: [shade], draw: [mark, edge, name] },
  }, [spec.x, ...spec.series.map(s => s.y)]);
  u.over.addEventListener("mousemove", evt => {
    const [x] = under(u, evt), k = u.posToIdx(x), rows = [[spec.xname, spec.x[k].toFixed(spec.xdec ?? 1)]];
    for (const e of spec.extra || []) if (e.names[e.at[k]] !== undefined && e.names[e.at[k]] !== "") rows.push([e.name, e.names[e.at[k]]]);
    if (places && rotationAtPoint) rows.push(...rotationAtPoint(places.names[places.at[k]]));
    else if (spec.group === "time" && rotationAtTime) rows.push(...rotationAtTime(spec.x[k]));
    spec.series.forEach((s, i) => { if (u.series[i + 1].show) rows.push([s.name, s.y[k] === null ? "–" : `${minus(String(+s.y[k].toPrecision(5)))} ${spec.unit || ""}`, tone(s.color)]); });
    for (const m of spec.marks || []) if (Math.abs(u.valToPos(m.x, "x") - x) < 6) rows.push(["dip", m.label, LIMIT]);
    showTip(evt, rows);
  });
  return u;
}
