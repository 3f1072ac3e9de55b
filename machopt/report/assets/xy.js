// X–Y pictures: points with error bars, lines and bands over one pair of axes of uPlot; hover names the nearest point.
function xyChart(host, spec) {
  const pad = (lo, hi, share) => { const p = (hi - lo || Math.abs(hi) || 1) * share; return [lo - p, hi + p]; };
  // What the shown layers span, on the scales' own measure.
  const span = u => {
    const fx = spec.xlog ? Math.log10 : v => v, fy = spec.ylog ? Math.log10 : v => v;
    let [x0, x1, y0, y1] = [Infinity, -Infinity, Infinity, -Infinity];
    const wide = v => { if (v != null && (!spec.xlog || v > 0)) { x0 = Math.min(x0, fx(v)); x1 = Math.max(x1, fx(v)); } };
    const high = v => { if (v != null && (!spec.ylog || v > 0)) { y0 = Math.min(y0, fy(v)); y1 = Math.max(y1, fy(v)); } };
    spec.layers.forEach((l, i) => {
      if (l.fit === false || (u.series[i + 1] && !u.series[i + 1].show)) return;
      for (const values of [l.x, l.xlo, l.xhi]) (values || []).forEach(wide);
      for (const values of [l.y, l.lo, l.hi]) (values || []).forEach(high);
    });
    for (const h of spec.hlines || []) if (h.fit) high(h.y);
    if (x0 > x1) [x0, x1] = [0, 1];
    if (y0 > y1) [y0, y1] = [0, 1];
    if (spec.equal) { x0 = y0 = Math.min(x0, y0); x1 = y1 = Math.max(x1, y1); }
    [x0, x1] = spec.xcats ? [-0.6, spec.xcats.length - 0.4] : pad(x0, x1, 0.05);
    const low = y0;
    [y0, y1] = spec.ycats ? [-0.6, spec.ycats.length - 0.4] : pad(y0, y1, 0.06);
    if (spec.ymin !== undefined && !spec.ycats) y0 = Math.min(fy(spec.ymin), low);
    const back = (v, log) => log ? 10 ** v : v;
    return { x: [back(x0, spec.xlog), back(x1, spec.xlog)], y: [back(y0, spec.ylog), back(y1, spec.ylog)] };
  };
  const known = (l, k) => l.x[k] !== null && l.y[k] !== null;
  const stroke = (ctx, path, color, width, alpha = 1, dash = []) => { ctx.strokeStyle = color; ctx.lineWidth = width; ctx.globalAlpha = alpha; ctx.setLineDash(dash); ctx.stroke(path); ctx.globalAlpha = 1; };
  const draw = {
    band(ctx, l, X, Y) {
      const p = new Path2D();
      l.x.forEach((x, k) => p.lineTo(X(x), Y(l.hi[k])));
      for (let k = l.x.length - 1; k >= 0; k--) p.lineTo(X(l.x[k]), Y(l.lo[k]));
      ctx.fillStyle = tone(l.color); ctx.globalAlpha = 0.16; ctx.fill(p); ctx.globalAlpha = 1;
    },
    line(ctx, l, X, Y) {
      const p = new Path2D();
      let pen = false;
      l.x.forEach((x, k) => { if (known(l, k)) p[pen ? "lineTo" : "moveTo"](X(x), Y(l.y[k])); pen = known(l, k); });
      stroke(ctx, p, tone(l.color), l.width || 1.5, 1, dashes(l.dash));
    },
    points(ctx, l, X, Y) {
      const bars = new Path2D(), marks = new Path2D(), r = l.size || 3;
      l.x.forEach((v, k) => {
        if (!known(l, k)) return;
        const x = X(v), y = Y(l.y[k]);
        if (l.lo) { bars.moveTo(x, Y(l.lo[k])); bars.lineTo(x, Y(l.hi[k])); }
        if (l.xlo) { bars.moveTo(X(l.xlo[k]), y); bars.lineTo(X(l.xhi[k]), y); }
        const p = new Path2D();
        if (l.mark === "diamond") { p.moveTo(x, y - r - 1); p.lineTo(x + r + 1, y); p.lineTo(x, y + r + 1); p.lineTo(x - r - 1, y); p.closePath(); } else p.arc(x, y, r, 0, 2 * Math.PI);
        marks.addPath(p);
      });
      stroke(ctx, bars, tone(l.color), l.bar || 1, l.bar ? 1 : 0.45);
      ctx.fillStyle = l.hollow ? PAPER : tone(l.color); ctx.globalAlpha = l.mark === "diamond" ? 1 : l.hollow ? 0.6 : 0.75; ctx.fill(marks, "nonzero");
      stroke(ctx, marks, tone(l.color), 1);
    },
  };
  const levels = u => paint(u, (ctx, b, X, Y) => {
    for (const h of spec.hlines || []) rule(ctx, b.x, Y(h.y), b.x + b.w, Y(h.y), h.class === "axis" ? AXIS : LIMIT, h.class === "axis" ? [] : [6, 4]);
  });
  const named = spec.layers.map(l => ({ ...l, name: l.legend === false ? "" : l.name || "" }));
  const u = plot(host, {
    title: spec.title, height: spec.height || 280, padding: [8, 14, 0, 0],
    legend: legend(named, named.filter(l => l.name).length > 1),
    cursor: { drag: { x: true, y: true, uni: 20 }, points: { show: false }, y: false, x: false },
    scales: { x: { time: false, distr: spec.xlog ? 3 : 1, range: u => span(u).x }, y: { distr: spec.ylog ? 3 : 1, range: u => span(u).y } },
    axes: [axis(2, spec.xlabel, { grid: false, log: spec.xlog, names: spec.xcats }), axis(3, spec.ylabel, { log: spec.ylog, names: spec.ycats && spec.ycats.map(fitting), size: spec.ycats ? roomy(spec.ycats.map(fitting)) : 46 })],
    series: [{}, ...named.map(l => ({ label: l.name, class: l.name ? (l.type === "points" && l.mark ? "diamonds" : l.type) : "unnamed", tint: l.color, stroke: () => tone(l.color), paths: () => null, points: { show: false } }))],
    hooks: { drawAxes: [levels], drawSeries: [(u, i) => { const l = spec.layers[i - 1]; paint(u, (ctx, b, X, Y) => draw[l.type](ctx, l, X, Y)); }], draw: [edge] },
  }, [[0, 1], ...named.map(() => [null, null])]);
  const ring = document.createElement("div");
  ring.className = "ring";
  u.over.appendChild(ring);
  const hide = () => { ring.style.display = "none"; hideTip(); };
  u.over.addEventListener("mouseleave", hide);
  u.over.addEventListener("mousemove", evt => {
    const [mx, my] = under(u, evt);
    let best = null, far = 400;
    spec.layers.forEach((l, i) => {
      if (l.type !== "points" || !u.series[i + 1].show) return;
      l.x.forEach((v, k) => {
        if (!known(l, k)) return;
        const x = u.valToPos(v, "x"), y = u.valToPos(l.y[k], "y"), d = (x - mx) ** 2 + (y - my) ** 2;
        if (d < far) { far = d; best = [x, y, l, k]; }
      });
    });
    if (!best) return hide();
    const [x, y, l, k] = best;
    ring.style.cssText = `display:block;left:${x}px;top:${y}px`;
    const rows = [[l.name, "", tone(l.color)], ...(l.labels && l.labels[k] || [])];
    if (!spec.xcats) rows.push([spec.xname || spec.xlabel || "x", +l.x[k].toPrecision(5)]);
    if (!spec.ycats) rows.push([spec.yname || spec.ylabel || "y", +l.y[k].toPrecision(5)]);
    showTip(evt, rows);
  });
  return u;
}
