// Pieces of SVG, for keys and stick figures.
function el(tag, attrs, parent, text) {
  const e = document.createElementNS("http://www.w3.org/2000/svg", tag);
  for (const k in attrs) e.setAttribute(k, attrs[k]);
  if (text !== undefined) e.textContent = text;
  if (parent) parent.appendChild(e);
  return e;
}

// The map path length × rotation: colour is the index, hatching says why a place cannot be used.
const RAMP = [[68, 1, 84], [72, 40, 120], [62, 74, 137], [49, 104, 142], [38, 130, 142], [31, 158, 137], [53, 183, 121], [110, 206, 88], [181, 222, 43], [253, 231, 37]];

function ramp(t) {
  const x = Math.min(1, Math.max(0, t)) * (RAMP.length - 1), i = Math.min(RAMP.length - 2, Math.floor(x)), f = x - i;
  return RAMP[i].map((a, k) => a + f * (RAMP[i + 1][k] - a));
}

const INK = [92, 98, 108], PALE = [226, 228, 231], WHITE = [255, 255, 255];
const NOT_CHECKED = 7;
// Colour of pixel (x, y) for each code of report/placecodes.py that is no answer; patterns differ so that they survive a grey print.
const PATTERN = {
  1: () => PALE,
  2: (x, y) => ((x + y) % 12 < 3 ? INK : PALE),
  3: (x, y) => (y % 9 < 2 ? INK : WHITE),
  4: (x, y) => (x % 9 < 2 ? INK : WHITE),
  5: (x, y) => (x % 10 < 2 || y % 10 < 2 ? INK : WHITE),
  6: (x, y) => ((x - y + 100000) % 10 < 4 ? [126, 34, 40] : [222, 178, 178]),
  8: (x, y) => ((x + y) % 12 < 2 || (x - y + 1200) % 12 < 2 ? INK : WHITE), // excluded by the user
  9: (x, y) => ((x - y + 120000) % 12 < 3 ? INK : WHITE), // below min_stability_ratio
  [NOT_CHECKED]: (x, y) => (x % 12 < 2 && y % 12 < 2 ? INK : WHITE),
};

function bytes(text) {
  const raw = atob(text), out = new Uint8Array(raw.length);
  for (let i = 0; i < raw.length; i++) out[i] = raw.charCodeAt(i);
  return out;
}

// Colours end where two of a hundred places are softer, so that these do not bleach the rest: the key says how far they go.
function softEnd(end, worst) {
  const short = v => `${+v.toPrecision(3)}`;
  return short(end) === short(worst) ? `soft ${short(end)}` : `soft ${short(end)} (worst ${short(worst)})`;
}

function swatch(name, color) {
  const item = document.createElement("span"), canvas = document.createElement("canvas"), ctx = canvas.getContext("2d");
  canvas.width = 44; canvas.height = 28;
  for (let x = 0; x < 44; x++) for (let y = 0; y < 28; y++) { ctx.fillStyle = `rgb(${color(x, y).join(",")})`; ctx.fillRect(x, y, 1, 1); }
  item.append(canvas, name);
  return item;
}

// Called with the map's plot and the places of its stations whenever that has been made anew (see steer.js).
let onMapDrawn = null;

function heatMap(host, spec) {
  const N = spec.stations, R = spec.rotations, status = bytes(spec.status);
  const level = new Uint16Array(bytes(spec.index).buffer);
  const valueOf = k => (level[k] === 65535 ? null : spec.lowest + level[k] / 65534 * (spec.highest - spec.lowest));
  const goodness = v => { const t = (v - spec.from) / (spec.to - spec.from || 1); return spec.large_is_good ? t : 1 - t; };
  const lut = new Uint8Array(3 * 256);
  for (let i = 0; i < 256; i++) lut.set(ramp(i / 255), 3 * i);
  const half = (spec.rotation[R - 1] - spec.rotation[0]) / Math.max(1, R - 1) / 2 || 2.5;
  const g0 = spec.rotation[0] - half, g1 = spec.rotation[R - 1] + half;
  const step = [5, 10, 15, 30, 45, 60, 90].find(d => (g1 - g0) / d <= 9) || 90;
  let byPoint = spec.by_point, u = null;
  const rowAt = (u, y) => Math.min(R - 1, Math.max(0, Math.floor((u.posToVal(y, "y") - g0) / (g1 - g0) * R)));
  const turned = v => v - 360 * Math.round(v / 360), degrees = v => minus(`${(Math.abs(v) < 0.05 ? 0 : v).toFixed(1)}°`);

  function image(w, h, edges, x0, x1) {
    const canvas = document.createElement("canvas");
    canvas.width = w; canvas.height = h;
    const ctx = canvas.getContext("2d"), img = ctx.createImageData(w, h), px = img.data;
    const rowOf = new Int32Array(h);
    for (let y = 0; y < h; y++) rowOf[y] = Math.min(R - 1, Math.floor((h - 1 - y + 0.5) / h * R));
    let k = 0;
    for (let x = 0; x < w; x++) {
      const v = x0 + (x + 0.5) / w * (x1 - x0);
      while (k < N - 1 && v >= edges[k + 1]) k++;
      for (let y = 0; y < h; y++) {
        const cell = k * R + rowOf[y], s = status[cell], value = valueOf(cell), at = 4 * (y * w + x);
        let rgb;
        if (value !== null && (s === 0 || s === NOT_CHECKED)) {
          const i = 3 * Math.round(255 * Math.min(1, Math.max(0, goodness(value))));
          rgb = s === NOT_CHECKED && x % 18 < 2 && (y + 9 * (Math.floor(x / 18) % 2)) % 18 < 2 ? WHITE : [lut[i], lut[i + 1], lut[i + 2]];
        } else rgb = (PATTERN[s] || PATTERN[NOT_CHECKED])(x, y);
        px[at] = rgb[0]; px[at + 1] = rgb[1]; px[at + 2] = rgb[2]; px[at + 3] = 255;
      }
    }
    ctx.putImageData(img, 0, 0);
    return canvas;
  }

  function draw() {
    const xs = byPoint ? spec.rank : spec.s, edges = new Float64Array(N + 1);
    for (let k = 1; k < N; k++) edges[k] = (xs[k - 1] + xs[k]) / 2;
    edges[0] = xs[0]; edges[N] = xs[N - 1];
    if (edges[N] <= edges[0]) { edges[0] -= 0.5; edges[N] += 0.5; }
    const colours = u => paint(u, (ctx, b) => {
      ctx.drawImage(image(2 * Math.round(b.w), 2 * Math.round(b.h), edges, u.scales.x.min, u.scales.x.max), b.x, b.y, b.w, b.h);
    });
    const lines = u => paint(u, (ctx, b, X, Y) => {
      ctx.lineJoin = "round";
      for (const line of spec.lines) {
        const p = new Path2D();
        let last = null;
        line.y.forEach((v, k) => {
          if (v !== null) {
            const x = X(xs[k]), y = Y(v);
            if (last === null || Math.abs(v - last) > 180) { p.moveTo(x, y); p.lineTo(x + 0.1, y); } else p.lineTo(x, y);
          }
          last = v;
        });
        for (const [color, wide, dash] of [[line.casing, 2.2, []], [line.color, 0, dashes(line.dash)]]) { ctx.strokeStyle = color; ctx.lineWidth = line.width + wide; ctx.setLineDash(dash); ctx.stroke(p); }
      }
    });
    if (u) { PLOTS.splice(PLOTS.indexOf(u), 1); u.destroy(); }
    host.replaceChildren(key());
    const ends = [edges[0], edges[N]], sync = byPoint ? undefined : { key: spec.group, setSeries: false, scales: ["x", null] };
    u = plot(host, {
      axisOf: byPoint ? "station" : spec.group, height2: true,
      pick: (u, evt) => { const [x, y] = under(u, evt); return { kind: "map", k: u.posToIdx(x), r: rowAt(u, y) }; },
      height: 400, padding: [8, 14, 0, 0], legend: { show: false },
      cursor: { sync, drag: { x: true, y: false }, points: { show: false } },
      scales: { x: { time: false, range: (u, lo, hi) => lo === xs[0] && hi === xs[N - 1] ? ends : [lo, hi] }, y: { range: [g0, g1] } },
      axes: [
        axis(2, byPoint ? "Station along the toolpath" : spec.xlabel, { grid: false }),
        axis(3, "Rotation about the tool axis φ (deg)", {
          grid: false, values: (u, at) => at.map(v => minus(`${v}°`)),
          splits: () => Array.from({ length: 1 + Math.floor((g1 - g0) / step) }, (_, i) => (Math.ceil(g0 / step) + i) * step).filter(v => v <= g1),
        }),
      ],
      series: [{}, { paths: () => null, points: { show: false } }], hooks: { drawClear: [colours], draw: [lines, edge] },
    }, [xs, xs.map(() => null)]);
    u.over.addEventListener("mousemove", evt => {
      const [x, y] = under(u, evt);
      tell(u.posToIdx(x), rowAt(u, y), evt);
    });
    function tell(k, r, evt, exact, more = []) { // exact: φ itself, where it lies between the rows
      const phi = exact ?? spec.rotation[r];
      const cell = k * R + r, value = valueOf(cell), rows = [["point", +spec.point[k].toFixed(2)], ["path length", `${spec.s[k].toFixed(1)} mm`], ["φ", degrees(phi)]];
      if (spec.offset) rows.push(["γ", degrees(turned(phi + spec.offset[k]))]);
      if (value !== null) rows.push([spec.label, `${+value.toPrecision(4)} ${spec.unit}`]);
      rows.push(["state", spec.names[status[cell]]]);
      for (const l of spec.lines) if (l.y[k] !== null) rows.push([l.name, spec.offset ? `φ ${degrees(l.y[k])}, γ ${degrees(turned(l.y[k] + spec.offset[k]))}` : `φ ${degrees(l.y[k])}`, l.color]);
      if (onPick && exact === undefined) rows.push(["click", "sets the robot to this place"]);
      rows.push(...more);
      showTip(evt, rows);
      return rows;
    }
    u.tellAt = (k, phi, evt, more) => tell(k, Math.min(R - 1, Math.max(0, Math.floor((phi - g0) / (g1 - g0) * R))), evt, phi, more);
    byKeys(u, xs, tell);
    if (onMapDrawn) onMapDrawn(u, xs);
  }

  // The keyboard's pointer: arrows go from place to place, Enter sets the robot there. The place is announced, too.
  function byKeys(u, xs, tell) {
    const liveText = document.createElement("span"), over = u.over;
    let k = -1, r = 0;
    liveText.className = "aloud"; liveText.setAttribute("role", "status");
    host.appendChild(liveText);
    over.tabIndex = 0;
    over.setAttribute("role", "application");
    over.setAttribute("aria-label", "Map of path and rotation: arrow keys move a pointer, with Shift ten places, Home and End to the ends of the path, Enter sets the robot there");
    const begin = () => {
      const at = HERE[byPoint ? "station" : spec.group], phi = HERE.phi;
      const nearest = (values, v) => values.reduce((best, x, i) => (Math.abs(x - v) < Math.abs(values[best] - v) ? i : best), 0);
      k = Number.isFinite(at) && at !== null ? nearest(xs, at) : 0;
      r = phi === null ? R >> 1 : nearest(spec.rotation, phi);
    };
    const shown = () => {
      const left = u.valToPos(xs[k], "x"), top = u.valToPos(spec.rotation[r], "y"), box = over.getBoundingClientRect();
      u.setCursor({ left, top });
      liveText.textContent = tell(k, r, { clientX: box.left + left, clientY: box.top + top }).map(row => row.slice(0, 2).join(" ")).join(", ");
    };
    over.addEventListener("keydown", evt => {
      if (evt.target !== over || evt.ctrlKey || evt.altKey || evt.metaKey) return;
      if (evt.key === "Escape") { hideTip(); return; }
      if (k < 0) begin();
      if (evt.key === "Enter" || evt.key === " ") { evt.preventDefault(); if (onPick) onPick({ kind: "map", k, r }); shown(); return; }
      const by = evt.shiftKey ? 10 : 1, step = { ArrowLeft: [-by, 0], ArrowRight: [by, 0], ArrowUp: [0, by], ArrowDown: [0, -by], Home: [-N, 0], End: [N, 0] }[evt.key];
      if (!step) return;
      evt.preventDefault();
      const inside = xs.map((x, i) => i).filter(i => xs[i] >= u.scales.x.min && xs[i] <= u.scales.x.max); // of a map that is zoomed
      const ends = inside.length ? [inside[0], inside[inside.length - 1]] : [0, N - 1];
      k = Math.min(ends[1], Math.max(ends[0], k + step[0]));
      r = (r + step[1] + R) % R;
      shown();
    });
    over.addEventListener("blur", () => { k = -1; liveText.textContent = ""; hideTip(); });
  }

  function key() {
    const box = document.createElement("div");
    box.className = "map-key";
    const bar = document.createElement("div"), left = document.createElement("span"), right = document.createElement("span");
    bar.className = "bar";
    const stops = Array.from({ length: 10 }, (_, i) => `rgb(${RAMP[i].join(",")})`);
    bar.style.background = `linear-gradient(to right, ${stops.join(",")})`;
    const worst = spec.large_is_good ? spec.from : spec.to, best = spec.large_is_good ? spec.to : spec.from;
    left.textContent = softEnd(worst, spec.large_is_good ? spec.lowest : spec.highest); right.textContent = `stiff ${+best.toPrecision(3)} ${spec.unit}`;
    const scale = document.createElement("div");
    scale.className = "scale"; scale.append(left, bar, right);
    if (spec.known) box.appendChild(scale);
    for (const s of spec.present) if (s !== 0) box.appendChild(swatch(s === NOT_CHECKED ? "collision not checked" : spec.names[s], (x, y) => s === NOT_CHECKED ? (x % 14 < 3 && y % 14 < 3 ? WHITE : [38, 130, 142]) : PATTERN[s](x, y)));
    for (const l of spec.lines) {
      const item = document.createElement("span"), k = el("svg", { viewBox: "0 0 34 10", width: 34, height: 10 });
      el("line", { x1: 1, x2: 33, y1: 5, y2: 5, stroke: l.casing, "stroke-width": l.width + 2.2 }, k);
      el("line", { x1: 1, x2: 33, y1: 5, y2: 5, stroke: l.color, "stroke-width": l.width, "stroke-dasharray": l.dash || "none" }, k);
      item.append(k, l.name);
      box.appendChild(item);
    }
    const flip = document.createElement("button");
    flip.textContent = byPoint ? "show over path length" : "show by station";
    flip.onclick = () => { byPoint = !byPoint; draw(); };
    box.appendChild(flip);
    return box;
  }

  draw();
}
