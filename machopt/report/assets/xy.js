// X–Y pictures in SVG: points with error bars, lines, bands and ellipses over one pair of axes; hover names the nearest point.
function xyChart(host, spec) {
  const hidden = new Set();
  const draw = () => {
    const F = frame(host, spec, { l: spec.left || 60, r: 14, t: 8, b: spec.xlabel || spec.xcats ? 40 : 24 }, spec.height || 280);
    const fx = spec.xlog ? Math.log10 : v => v, fy = spec.ylog ? Math.log10 : v => v;
    const layers = spec.layers.filter((_, i) => !hidden.has(i));
    let x0 = Infinity, x1 = -Infinity, y0 = Infinity, y1 = -Infinity;
    const grow = (x, y) => {
      if (x !== null && x !== undefined && (!spec.xlog || x > 0)) { x0 = Math.min(x0, fx(x)); x1 = Math.max(x1, fx(x)); }
      if (y !== null && y !== undefined && (!spec.ylog || y > 0)) { y0 = Math.min(y0, fy(y)); y1 = Math.max(y1, fy(y)); }
    };
    for (const l of layers) if (l.fit !== false) {
      for (let k = 0; k < l.x.length; k++) {
        if (l.y) grow(l.x[k], l.y[k]); else grow(l.x[k], null);
        if (l.lo) { grow(l.x[k], l.lo[k]); grow(l.x[k], l.hi[k]); }
        if (l.xlo) { grow(l.xlo[k], null); grow(l.xhi[k], null); }
      }
    }
    for (const h of spec.hlines || []) if (h.fit) grow(null, h.y);
    if (spec.xcats) { x0 = -0.6; x1 = spec.xcats.length - 0.4; }
    if (spec.ycats) { y0 = -0.6; y1 = spec.ycats.length - 0.4; }
    if (x0 > x1) { x0 = 0; x1 = 1; }
    if (y0 > y1) { y0 = 0; y1 = 1; }
    if (spec.equal) { x0 = y0 = Math.min(x0, y0); x1 = y1 = Math.max(x1, y1); }
    if (!spec.xcats) { const p = (x1 - x0 || Math.abs(x1) || 1) * 0.05; x0 -= p; x1 += p; }
    if (!spec.ycats) { const p = (y1 - y0 || Math.abs(y1) || 1) * 0.06; if (spec.ymin !== undefined) y0 = fy(spec.ymin); else y0 -= p; y1 += p; }
    const logTicks = (lo, hi) => {
      const at = [], steps = hi - lo > 2.5 ? [1] : hi - lo > 0.9 ? [1, 2, 5] : [1, 1.5, 2, 3, 4, 5, 6, 8];
      for (let e = Math.floor(lo); e <= hi; e++) for (const m of steps) { const v = e + Math.log10(m); if (v >= lo && v <= hi) at.push(v); }
      return { at, text: v => { const n = 10 ** v; return n >= 1e4 || n < 1e-2 ? n.toExponential(1).replace("e+", "e").replace(".0", "") : String(+n.toPrecision(3)); } };
    };
    const cats = (names) => ({ at: names.map((_, i) => i), text: v => names[v] });
    const Y = yAxis(F, spec.ylabel, y0, y1, true, spec.ycats ? cats(spec.ycats) : spec.ylog ? logTicks(y0, y1) : undefined);
    let X;
    if (spec.xcats || spec.xlog) {
      X = v => F.M.l + (v - x0) / (x1 - x0 || 1) * F.w;
      const t = spec.xcats ? cats(spec.xcats) : logTicks(x0, x1), base = F.M.t + F.h;
      const every = spec.xcats ? Math.ceil(spec.xcats.length * 34 / F.w) : 1;
      t.at.forEach((v, i) => {
        if (i % every) return;
        el("line", { x1: X(v), x2: X(v), y1: base, y2: base + 4, class: "axis" }, F.svg);
        el("text", { x: X(v), y: base + 16, class: "tick", "text-anchor": "middle" }, F.svg, t.text(v));
      });
      if (spec.xlabel) el("text", { x: F.M.l + F.w / 2, y: F.H - 3, class: "label", "text-anchor": "middle" }, F.svg, spec.xlabel);
    } else X = xAxis(F, spec, x0, x1);
    const clip = el("clipPath", { id: `clip-${spec.id}` }, el("defs", {}, F.svg));
    el("rect", { x: F.M.l, y: F.M.t, width: F.w, height: F.h }, clip);
    const g = el("g", { "clip-path": `url(#clip-${spec.id})` }, F.svg);
    const px = v => X(fx(v)), py = v => Y(fy(v)), hits = [];
    for (const h of spec.hlines || []) el("line", { x1: F.M.l, x2: F.M.l + F.w, y1: py(h.y), y2: py(h.y), class: h.class || "limit" }, g);
    for (const l of layers) {
      const n = l.x.length, ok = k => l.x[k] !== null && l.y[k] !== null;
      if (l.type === "band") {
        let d = "";
        for (let k = 0; k < n; k++) d += (k ? "L" : "M") + px(l.x[k]).toFixed(1) + " " + py(l.hi[k]).toFixed(1);
        for (let k = n - 1; k >= 0; k--) d += "L" + px(l.x[k]).toFixed(1) + " " + py(l.lo[k]).toFixed(1);
        el("path", { d: d + "Z", fill: l.color, "fill-opacity": 0.16, stroke: "none" }, g);
      } else if (l.type === "line") {
        let d = "", pen = false;
        for (let k = 0; k < n; k++) {
          if (!ok(k)) { pen = false; continue; }
          d += (pen ? "L" : "M") + px(l.x[k]).toFixed(1) + " " + py(l.y[k]).toFixed(1);
          pen = true;
        }
        el("path", { d, class: "line", stroke: l.color, "stroke-width": l.width || 1.5, "stroke-dasharray": l.dash || "none" }, g);
      } else {
        let bars = "";
        for (let k = 0; k < n; k++) {
          if (!ok(k)) continue;
          const a = px(l.x[k]), b = py(l.y[k]);
          if (l.lo) bars += `M${a.toFixed(1)} ${py(l.lo[k]).toFixed(1)}V${py(l.hi[k]).toFixed(1)}`;
          if (l.xlo) bars += `M${px(l.xlo[k]).toFixed(1)} ${b.toFixed(1)}H${px(l.xhi[k]).toFixed(1)}`;
        }
        if (bars) el("path", { d: bars, stroke: l.color, "stroke-width": l.bar || 1, "stroke-opacity": l.bar ? 1 : 0.45, fill: "none" }, g);
        for (let k = 0; k < n; k++) {
          if (!ok(k)) continue;
          const a = px(l.x[k]), b = py(l.y[k]), r = l.size || 3;
          if (l.mark === "diamond") el("path", { d: `M${a} ${b - r - 1}l${r + 1} ${r + 1}l${-r - 1} ${r + 1}l${-r - 1} ${-r - 1}z`, fill: l.hollow ? "#fff" : l.color, stroke: l.color }, g);
          else el("circle", { cx: a.toFixed(1), cy: b.toFixed(1), r, fill: l.hollow ? "#fff" : l.color, stroke: l.color, "fill-opacity": l.hollow ? 0.6 : 0.75, "stroke-width": 1 }, g);
          hits.push([a, b, l, k]);
        }
      }
    }
    el("rect", { x: F.M.l, y: F.M.t, width: F.w, height: F.h, class: "box" }, F.svg);
    const ring = el("circle", { r: 6, fill: "none", stroke: "#222", "stroke-width": 1.2, visibility: "hidden" }, F.svg);
    const hit = el("rect", { x: F.M.l, y: F.M.t, width: F.w, height: F.h, class: "hit" }, F.svg);
    hit.addEventListener("pointermove", evt => {
      const box = F.svg.getBoundingClientRect(), s = F.W / box.width;
      const mx = (evt.clientX - box.left) * s, my = (evt.clientY - box.top) * s;
      let best = null, far = 400;
      for (const h of hits) { const d = (h[0] - mx) ** 2 + (h[1] - my) ** 2; if (d < far) { far = d; best = h; } }
      if (!best) { ring.setAttribute("visibility", "hidden"); return hideTip(); }
      const [a, b, l, k] = best;
      ring.setAttribute("cx", a); ring.setAttribute("cy", b); ring.setAttribute("visibility", "visible");
      const rows = [[l.name, "", l.color]];
      if (l.labels && l.labels[k]) rows.push(...l.labels[k].map(p => [p[0], p[1]]));
      if (!spec.xcats) rows.push([spec.xname || spec.xlabel || "x", +l.x[k].toPrecision(5)]);
      if (!spec.ycats) rows.push([spec.yname || spec.ylabel || "y", +l.y[k].toPrecision(5)]);
      showTip(evt, rows);
    });
    hit.addEventListener("pointerleave", () => { ring.setAttribute("visibility", "hidden"); hideTip(); });
    host.replaceChildren();
    if (spec.title) { const h = document.createElement("div"); h.className = "chart-title"; h.textContent = spec.title; host.appendChild(h); }
    const named = spec.layers.filter(l => l.name && l.legend !== false);
    if (named.length > 1) {
      const box = document.createElement("div");
      box.className = "legend";
      for (const l of named) {
        const i = spec.layers.indexOf(l), b = document.createElement("button");
        const key = el("svg", { viewBox: "0 0 26 10", width: 26, height: 10 });
        if (l.type === "points") el("circle", { cx: 13, cy: 5, r: 3.5, fill: l.hollow ? "#fff" : l.color, stroke: l.color }, key);
        else el("line", { x1: 1, x2: 25, y1: 5, y2: 5, stroke: l.color, "stroke-width": l.type === "band" ? 8 : 2.4, "stroke-opacity": l.type === "band" ? 0.25 : 1, "stroke-dasharray": l.dash || "none" }, key);
        b.append(key, l.name);
        b.className = hidden.has(i) ? "off" : "";
        b.onclick = () => { if (!hidden.delete(i)) hidden.add(i); draw(); };
        box.appendChild(b);
      }
      host.appendChild(box);
    }
    host.appendChild(F.svg);
  };
  draw();
  let width = host.clientWidth;
  new ResizeObserver(() => { if (host.clientWidth && host.clientWidth !== width) { width = host.clientWidth; draw(); } }).observe(host);
}
