// Line charts in SVG: hover reads values, dragging zooms every chart of the same group, a click on a legend entry hides it.
const NS = "http://www.w3.org/2000/svg";
const groups = {};

function el(tag, attrs, parent, text) {
  const e = document.createElementNS(NS, tag);
  for (const k in attrs) e.setAttribute(k, attrs[k]);
  if (text !== undefined) e.textContent = text;
  if (parent) parent.appendChild(e);
  return e;
}

function ticks(lo, hi, n) {
  const span = hi - lo || 1, raw = span / n, mag = Math.pow(10, Math.floor(Math.log10(raw)));
  const step = [1, 2, 2.5, 5, 10].map(m => m * mag).find(s => span / s <= n) || 10 * mag;
  const out = [];
  for (let i = Math.ceil(lo / step - 1e-9); i * step <= hi + 1e-9 * span; i++) out.push(i * step);
  return { at: out, text: v => v.toFixed(decimalsOf(step)).replace("-", "−") };
}

function decimalsOf(step) {
  for (let d = 0; d < 9; d++) if (Math.abs(step * 10 ** d - Math.round(step * 10 ** d)) < 1e-6) return d;
  return 9;
}

const tip = document.createElement("div");
tip.className = "tip";
document.body.appendChild(tip);

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

function nearest(x, v) {
  let lo = 0, hi = x.length - 1;
  while (hi - lo > 1) { const m = (lo + hi) >> 1; if (x[m] < v) lo = m; else hi = m; }
  return Math.abs(x[lo] - v) <= Math.abs(x[hi] - v) ? lo : hi;
}

// Shared by charts and the map: the plot's svg, its x axis, drag to zoom, double click to see all again.
function frame(host, spec, M, H) {
  const W = Math.max(320, host.clientWidth);
  const svg = el("svg", { viewBox: `0 0 ${W} ${H}`, class: "plot", role: "img", "aria-label": spec.title || "" });
  return { W, H, M, svg, w: W - M.l - M.r, h: H - M.t - M.b };
}

function xAxis(F, spec, x0, x1) {
  const X = v => F.M.l + (v - x0) / (x1 - x0 || 1) * F.w;
  const t = ticks(x0, x1, Math.max(3, F.w / 90)), base = F.M.t + F.h;
  for (const v of t.at) {
    el("line", { x1: X(v), x2: X(v), y1: base, y2: base + 4, class: "axis" }, F.svg);
    el("text", { x: X(v), y: base + 16, class: "tick", "text-anchor": "middle" }, F.svg, t.text(v));
  }
  if (spec.xlabel) el("text", { x: F.M.l + F.w / 2, y: F.H - 3, class: "label", "text-anchor": "middle" }, F.svg, spec.xlabel);
  return X;
}

function yAxis(F, label, y0, y1, grid, given) {
  const Y = v => F.M.t + F.h - (v - y0) / (y1 - y0 || 1) * F.h;
  const t = given || ticks(y0, y1, Math.max(3.6, F.h / 40));
  for (const v of t.at) {
    if (grid) el("line", { x1: F.M.l, x2: F.M.l + F.w, y1: Y(v), y2: Y(v), class: "grid" }, F.svg);
    el("text", { x: F.M.l - 6, y: Y(v) + 4, class: "tick", "text-anchor": "end" }, F.svg, t.text(v));
  }
  if (label) el("text", { transform: `translate(12 ${F.M.t + F.h / 2}) rotate(-90)`, class: "label", "text-anchor": "middle" }, F.svg, label);
  return Y;
}

function interact(F, range, full, group, onMove, onLeave) {
  const hit = el("rect", { x: F.M.l, y: F.M.t, width: F.w, height: F.h, class: "hit" }, F.svg);
  const sel = el("rect", { y: F.M.t, height: F.h, class: "select", width: 0 }, F.svg);
  const at = evt => {
    const box = F.svg.getBoundingClientRect();
    return { px: (evt.clientX - box.left) * F.W / box.width, py: (evt.clientY - box.top) * F.H / box.height };
  };
  const value = px => range[0] + (px - F.M.l) / F.w * (range[1] - range[0]);
  let start = null;
  hit.addEventListener("pointerdown", e => { start = at(e).px; hit.setPointerCapture(e.pointerId); });
  hit.addEventListener("pointermove", e => {
    const { px, py } = at(e);
    if (start === null) return onMove(e, value(px), px, py);
    sel.setAttribute("x", Math.min(start, px));
    sel.setAttribute("width", Math.abs(px - start));
  });
  hit.addEventListener("pointerup", e => {
    const a = value(start), b = value(at(e).px), moved = Math.abs(at(e).px - start) > 5;
    start = null;
    sel.setAttribute("width", 0);
    if (moved) zoom(group, [Math.max(full[0], Math.min(a, b)), Math.min(full[1], Math.max(a, b))]);
  });
  hit.addEventListener("dblclick", () => zoom(group, null));
  hit.addEventListener("pointerleave", () => { hideTip(); onLeave(); });
}

function zoom(group, range) {
  for (const c of groups[group] || []) { c.range = range; c.draw(); }
}

function register(group, c) {
  (groups[group] = groups[group] || []).push(c);
  c.draw();
  let width = 0;
  new ResizeObserver(() => {
    if (c.host.clientWidth && c.host.clientWidth !== width) { width = c.host.clientWidth; c.draw(); }
  }).observe(c.host);
}

function lineChart(host, spec) {
  const c = { host, range: null, hidden: new Set() };
  const full = [spec.x[0], spec.x[spec.x.length - 1]];
  if (full[0] === full[1]) { full[0] -= 0.5; full[1] += 0.5; }
  c.draw = () => {
    const [x0, x1] = c.range || full;
    const F = frame(host, spec, { l: 58, r: 14, t: spec.labels ? 20 : 8, b: spec.xlabel ? 36 : 22 }, spec.height || 230);
    const shown = spec.series.filter((_, i) => !c.hidden.has(i));
    let lo = spec.ymin ?? Infinity, hi = spec.ymax ?? -Infinity;
    for (const s of shown) for (let i = 0; i < spec.x.length; i++) {
      const v = s.y[i];
      if (v === null || spec.x[i] < x0 || spec.x[i] > x1) continue;
      if (v < lo) lo = v;
      if (v > hi) hi = v;
    }
    for (const l of spec.hlines || []) if (l.fit) { lo = Math.min(lo, l.y); hi = Math.max(hi, l.y); }
    if (lo > hi) { lo = 0; hi = 1; }
    const pad = (hi - lo || Math.abs(hi) || 1) * 0.06;
    if (spec.ymin === undefined) lo -= pad;
    if (!spec.fixedTop) hi += pad;
    for (const [i, b] of (spec.bands || []).entries()) {
      const a = Math.max(b.from, x0), z = Math.min(b.to, x1);
      if (a >= z) continue;
      const px = F.M.l + (a - x0) / (x1 - x0) * F.w, pw = (z - a) / (x1 - x0) * F.w;
      if (i % 2) el("rect", { x: px, y: F.M.t, width: pw, height: F.h, class: "band" }, F.svg);
      if (spec.labels && pw > 6.2 * b.label.length + 4)
        el("text", { x: px + pw / 2, y: F.M.t - 6, class: "tick", "text-anchor": "middle" }, F.svg, b.label);
    }
    const Y = yAxis(F, spec.ylabel, lo, hi, true), X = xAxis(F, spec, x0, x1);
    const clip = el("clipPath", { id: `clip-${spec.id}` }, el("defs", {}, F.svg));
    el("rect", { x: F.M.l, y: F.M.t - 1, width: F.w, height: F.h + 2 }, clip);
    const g = el("g", { "clip-path": `url(#clip-${spec.id})` }, F.svg);
    for (const l of spec.hlines || []) {
      el("line", { x1: F.M.l, x2: F.M.l + F.w, y1: Y(l.y), y2: Y(l.y), class: "limit" }, g);
      if (l.label) el("text", { x: F.M.l + F.w - 4, y: Y(l.y) + (l.below ? 13 : -4), class: "tick limit-text", "text-anchor": "end" }, g, l.label);
    }
    spec.series.forEach((s, i) => {
      if (c.hidden.has(i)) return;
      let dots = "", d = "", pen = false, last = -1;
      for (let k = 0; k < spec.x.length; k++) {
        const v = s.y[k];
        if (v === null) { pen = false; continue; }
        d += (pen ? "L" : "M") + X(spec.x[k]).toFixed(1) + " " + Y(v).toFixed(1);
        if (!pen && (k + 1 >= spec.x.length || s.y[k + 1] === null)) dots += `M${X(spec.x[k]).toFixed(1)} ${Y(v).toFixed(1)}h0.1`; // a hole
        pen = true;
      }
      el("path", { d, class: "line", stroke: s.color, "stroke-width": s.width || 1.6, "stroke-dasharray": s.dash || "none" }, g);
      if (dots) el("path", { d: dots, class: "line", stroke: s.color, "stroke-width": 5, "stroke-linecap": "round" }, g);
    });
    el("rect", { x: F.M.l, y: F.M.t, width: F.w, height: F.h, class: "box" }, F.svg);
    for (const m of spec.marks || []) {
      if (m.x < x0 || m.x > x1) continue;
      const p = el("path", { d: `M${X(m.x)} ${F.M.t + 11}l-5 -10h10z`, class: "mark" }, F.svg);
      el("title", {}, p, m.label);
    }
    const cursor = el("line", { y1: F.M.t, y2: F.M.t + F.h, class: "cursor" }, F.svg);
    interact(F, [x0, x1], full, spec.group, (evt, v) => {
      const k = nearest(spec.x, v);
      cursor.setAttribute("x1", X(spec.x[k])); cursor.setAttribute("x2", X(spec.x[k]));
      cursor.style.display = "block";
      const rows = [[spec.xname, spec.x[k].toFixed(spec.xdec ?? 1)]];
      for (const e of spec.extra || []) if (e.names[e.at[k]] !== undefined && e.names[e.at[k]] !== "") rows.push([e.name, e.names[e.at[k]]]);
      spec.series.forEach((s, i) => { if (!c.hidden.has(i)) rows.push([s.name, s.y[k] === null ? "–" : `${+s.y[k].toPrecision(5)} ${spec.unit || ""}`, s.color]); });
      showTip(evt, rows);
    }, () => { cursor.style.display = "none"; });
    host.replaceChildren();
    if (spec.title) { const h = document.createElement("div"); h.className = "chart-title"; h.textContent = spec.title; host.appendChild(h); }
    if (spec.series.length > 1 && spec.legend !== false) host.appendChild(legend(spec, c));
    host.appendChild(F.svg);
  };
  register(spec.group, c);
}

function legend(spec, c) {
  const box = document.createElement("div");
  box.className = "legend";
  spec.series.forEach((s, i) => {
    const b = document.createElement("button");
    const key = el("svg", { viewBox: "0 0 26 8", width: 26, height: 8 });
    el("line", { x1: 1, x2: 25, y1: 4, y2: 4, stroke: s.color, "stroke-width": 2.4, "stroke-dasharray": s.dash || "none" }, key);
    b.append(key, s.name);
    b.className = c.hidden.has(i) ? "off" : "";
    b.onclick = () => { if (!c.hidden.delete(i)) c.hidden.add(i); c.draw(); };
    box.appendChild(b);
  });
  return box;
}
