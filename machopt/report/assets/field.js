// A quantity over two or three axes: colours, isolines, hatching where there is no posture, and the arm under the pointer.
const FIELD_STYLE = `
.field .bar { display: flex; flex-wrap: wrap; gap: 8px 18px; align-items: center; margin: 6px 0 8px; font-size: 13px; }
.field select, .field input { font: inherit; } .field label { display: inline-flex; gap: 6px; align-items: center; }
.field .pick button { font: inherit; padding: 2px 10px; border: 1px solid #9aa3ad; background: #fff; cursor: pointer; margin-left: -1px; }
.field .pick button.on { background: #1552b8; border-color: #1552b8; color: #fff; }
.field .two { display: grid; grid-template-columns: minmax(0, 1fr) 340px; gap: 16px; align-items: start; }
.field .side h3 { margin: 0 0 4px; } .field .numbers table { font-size: 12.5px; width: auto; min-width: 60%; } .field .numbers th { background: none; position: static; }
.field .numbers td, .field .numbers th { padding: 2px 8px; } .field .numbers .here td { font-weight: 600; background: #eef3fb; }
.field .side .joints { font-size: 12px; color: var(--soft); font-variant-numeric: tabular-nums; margin: 4px 0; }
.field .iso { fill: none; stroke: #fff; stroke-width: 1; opacity: .85; pointer-events: none; }
.field .isotext { font-size: 10.5px; fill: #111; stroke: #fff; stroke-width: 3px; paint-order: stroke; pointer-events: none; }
@media (max-width: 900px) { .field .two { grid-template-columns: 1fr; } }`;

function valuesOf(v) {
  if (!v || !v.level) return () => null;
  const raw = new Uint16Array(bytes(v.level).buffer), a = v.log ? Math.log(v.low) : v.low, b = v.log ? Math.log(v.high) : v.high;
  return k => raw[k] === 65535 ? null : v.log ? Math.exp(a + raw[k] / 65534 * (b - a)) : a + raw[k] / 65534 * (b - a);
}

const LUT = Array.from({ length: 256 }, (_, i) => ramp(i / 255).map(Math.round));
const shown = (v, digits) => v === null ? "–" : String(+v.toPrecision(digits || 4)).replace("-", "−");

function logTicks(lo, hi) {
  const out = [], many = Math.log10(hi / lo) > 2;
  for (let e = Math.floor(Math.log10(lo)); e <= Math.log10(hi); e++)
    for (const m of many ? [1, 3] : [1, 2, 5]) { const v = m * 10 ** e; if (v >= lo && v <= hi) out.push(v); }
  return { at: out, text: v => shown(v, 3) };
}

// Line segments of value = level over a grid of nu × nv cell centres; cells with a hole are left out.
function isoline(at, nu, nv, level) {
  const out = [];
  for (let i = 0; i < nu - 1; i++) for (let j = 0; j < nv - 1; j++) {
    const c = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
    if (c.some(v => v === null)) continue;
    const corner = [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]], hit = [];
    for (let e = 0; e < 4; e++) {
      const a = c[e], b = c[(e + 1) % 4];
      if ((a < level) === (b < level)) continue;
      const t = (level - a) / (b - a), p = corner[e], q = corner[(e + 1) % 4];
      hit.push([p[0] + t * (q[0] - p[0]), p[1] + t * (q[1] - p[1])]);
    }
    if (hit.length === 2) out.push(hit);
    else if (hit.length === 4) { // saddle: join by the middle's side
      const mid = (c[0] + c[1] + c[2] + c[3]) / 4, same = (mid < level) === (c[0] < level);
      out.push(same ? [hit[0], hit[1]] : [hit[3], hit[0]], same ? [hit[2], hit[3]] : [hit[1], hit[2]]);
    }
  }
  return out;
}

function fieldMap(host, spec) {
  if (!document.getElementById("field-style")) {
    const style = document.createElement("style");
    style.id = "field-style"; style.textContent = FIELD_STYLE;
    document.head.appendChild(style);
  }
  const shape = spec.axes.map(a => a.values.length), volume = shape.length === 3, place = spec.kind !== "joints";
  const strides = shape.map((_, i) => shape.slice(i + 1).reduce((a, b) => a * b, 1));
  const layers = spec.layers.map(l => ({
    ...l, code: bytes(l.status), angle: new Int16Array(bytes(l.q).buffer), at: Object.fromEntries(Object.entries(l.value).map(([k, v]) => [k, valuesOf(v)])),
    guessAt: Object.fromEntries(Object.entries(l.value).filter(([, v]) => v.guess).map(([k, v]) => [k, bytes(v.guess)])),
    gammaAt: valuesOf(l.gamma), shortAt: valuesOf(l.shortfall),
  }));
  const start = layers.length > 1 && layers[0].best < 0 ? 1 : 0;
  const st = { field: spec.first, layer: start, scale: "p", lines: true, normal: 2, level: 0, keep: null, over: null };
  const field = () => spec.fields.find(f => f.key === st.field) || spec.fields[0];
  if (volume) st.level = layers[start].best >= 0 ? Math.floor(layers[start].best / strides[2]) % shape[2] : shape[2] >> 1;
  const uv = () => volume ? [0, 1, 2].filter(a => a !== st.normal) : [0, 1];
  const cell = (i, j) => { const [u, v] = uv(); return i * strides[u] + j * strides[v] + (volume ? st.level * strides[st.normal] : 0); };
  const qOf = (l, k) => l.angle[6 * k] === -32768 ? null : Array.from({ length: 6 }, (_, j) => l.angle[6 * k + j] * spec.angle);
  const hasArm = k => layers.some(l => qOf(l, k));
  const some = [];
  for (const l of layers) for (let k = 0, step = Math.max(1, Math.floor(l.code.length / 400)); k < l.code.length; k += step) { const q = qOf(l, k); if (q) some.push(armPoints(spec.arm, q)); }
  const views = some.length ? armViews(spec.arm, some) : null;
  const where = k => spec.axes.map((a, i) => a.values[Math.floor(k / strides[i]) % shape[i]]);

  const make = (tag, name, ...inside) => { const e = document.createElement(tag); e.className = name; e.append(...inside); return e; };
  const main = make("div", "picture"), keyBox = make("div", ""), numbers = make("div", "numbers"), side = make("div", "side"), bar = make("div", "bar");
  const left = make("div", "left", main, keyBox, numbers);
  host.replaceChildren(bar, make("div", "two", left, side));

  function labelled(text, node) { const l = document.createElement("label"); l.append(text, node); bar.appendChild(l); return node; }
  function select(text, options, value, onChange) {
    const s = document.createElement("select");
    for (const [v, name] of options) { const o = document.createElement("option"); o.value = v; o.textContent = name; s.appendChild(o); }
    s.value = value;
    s.onchange = () => { onChange(s.value); draw(); };
    return labelled(text, s);
  }
  let slider = null, sliderText = null;
  function controls() {
    select("Quantity", spec.fields.map(f => [f.key, f.unit ? `${f.name} (${f.unit})` : f.name]), field().key, v => { st.field = v; });
    if (layers.length > 1) {
      const box = document.createElement("span");
      box.className = "pick";
      layers.forEach((l, i) => { const b = document.createElement("button"); b.textContent = l.title; b.dataset.layer = i; b.onclick = () => { st.layer = i; draw(); }; box.appendChild(b); });
      bar.appendChild(box);
    }
    select("Scale", [["p", "2 to 98 % of the samples"], ["a", "least to largest"], ["l", "least to largest, logarithmic"]], st.scale, v => { st.scale = v; });
    const box = document.createElement("input");
    box.type = "checkbox"; box.checked = st.lines;
    box.onchange = () => { st.lines = box.checked; draw(); };
    const l = document.createElement("label"); l.append(box, "isolines"); bar.appendChild(l);
    if (volume) {
      select("Slice normal to", spec.axes.map((a, i) => [i, a.name]), st.normal, v => { st.normal = +v; st.level = shape[st.normal] >> 1; slider.max = shape[st.normal] - 1; slider.value = st.level; });
      slider = document.createElement("input");
      slider.type = "range"; slider.min = 0; slider.max = shape[st.normal] - 1; slider.value = st.level;
      slider.oninput = () => { st.level = +slider.value; draw(); };
      sliderText = document.createElement("span");
      labelled("at", slider).after(sliderText);
    }
  }

  // What is drawn of a field in a layer; a quantity that only the other layer has is taken from there.
  function source() {
    const f = field(), own = layers[st.layer], l = own.at[f.key] ? own : layers.find(x => x.at[f.key]);
    const v = l.value[f.key], all = st.scale !== "p";
    let from = all ? v.low : v.from, to = all ? v.high : v.to;
    const log = st.scale === "l" && v.low > 0;
    if (!(to > from)) { from -= Math.abs(from) * 0.01 || 0.5; to += Math.abs(to) * 0.01 || 0.5; }
    const part = x => log ? Math.log(x / from) / Math.log(to / from) : (x - from) / (to - from);
    return { f, l, v, from, to, log, part, good: x => f.better === "less" ? 1 - part(x) : part(x), value: l.at[f.key], guess: l.guessAt[f.key] };
  }

  function image(w, h, nu, nv, S) {
    const canvas = document.createElement("canvas");
    canvas.width = w; canvas.height = h;
    const ctx = canvas.getContext("2d"), img = ctx.createImageData(w, h), px = img.data;
    for (let y = 0; y < h; y++) {
      const j = Math.min(nv - 1, Math.floor((h - 1 - y + 0.5) / h * nv));
      for (let x = 0; x < w; x++) {
        const k = cell(Math.min(nu - 1, Math.floor((x + 0.5) / w * nu)), j), s = S.l.code[k], value = S.value(k);
        let rgb;
        if (s !== 0) rgb = (PATTERN[s] || PATTERN[7])(x, y);
        else if (value === null) rgb = WHITE;
        else rgb = S.guess && S.guess[k] && x % 14 < 3 && (y + 7 * (Math.floor(x / 14) % 2)) % 14 < 3 ? WHITE : LUT[Math.round(255 * Math.min(1, Math.max(0, S.good(value))))];
        const at = 4 * (y * w + x);
        px[at] = rgb[0]; px[at + 1] = rgb[1]; px[at + 2] = rgb[2]; px[at + 3] = 255;
      }
    }
    ctx.putImageData(img, 0, 0);
    return canvas.toDataURL();
  }

  function scaleBar(F, S) {
    const x = F.M.l + F.w + 16, w = 15, n = 60;
    for (let i = 0; i < n; i++) {
      const t = (i + 0.5) / n;
      el("rect", { x, width: w, y: F.M.t + F.h * (1 - (i + 1) / n), height: F.h / n + 0.6, fill: `rgb(${ramp(S.f.better === "less" ? 1 - t : t).map(Math.round).join(",")})` }, F.svg);
    }
    el("rect", { x, y: F.M.t, width: w, height: F.h, class: "box" }, F.svg);
    const t = S.log ? logTicks(S.from, S.to) : ticks(S.from, S.to, Math.max(3, F.h / 55));
    for (const v of t.at) {
      const y = F.M.t + F.h * (1 - S.part(v));
      el("line", { x1: x + w, x2: x + w + 4, y1: y, y2: y, class: "axis" }, F.svg);
      el("text", { x: x + w + 7, y: y + 4, class: "tick" }, F.svg, t.text(v));
    }
    if (S.v.high > S.to * (1 + 1e-9)) el("text", { x, y: F.M.t - 6, class: "tick" }, F.svg, `up to ${shown(S.v.high, 3)}`);
    if (S.v.low < S.from * (1 - 1e-9)) el("text", { x, y: F.M.t + F.h + 14, class: "tick" }, F.svg, `from ${shown(S.v.low, 3)}`);
    el("text", { transform: `translate(${F.W - 5} ${F.M.t + F.h / 2}) rotate(-90)`, class: "label", "text-anchor": "middle" }, F.svg, S.f.unit ? `${S.f.name} (${S.f.unit})` : S.f.name);
    return t;
  }

  let frameNow = null;
  function draw() {
    const [u, v] = uv(), U = spec.axes[u], V = spec.axes[v], nu = shape[u], nv = shape[v], S = source();
    const du = U.values[1] - U.values[0], dv = V.values[1] - V.values[0];
    const u0 = U.values[0] - du / 2, u1 = U.values[nu - 1] + du / 2, v0 = V.values[0] - dv / 2, v1 = V.values[nv - 1] + dv / 2;
    const M = { l: 62, r: 98, t: 20, b: 38 }, W = Math.max(320, main.clientWidth);
    let w = W - M.l - M.r, h = Math.min(560, Math.max(200, place ? w * (v1 - v0) / (u1 - u0) : Math.min(w * 0.75, w * (v1 - v0) / (u1 - u0))));
    if (place) w = Math.min(w, h * (u1 - u0) / (v1 - v0));
    const F = { W: M.l + w + M.r, H: h + M.t + M.b, M, w, h };
    F.svg = el("svg", { viewBox: `0 0 ${F.W} ${F.H}`, class: "plot", role: "img", "aria-label": S.f.name, style: `width:${F.W}px;max-width:100%` });
    el("image", { href: image(2 * Math.round(w), 2 * Math.round(h), nu, nv, S), x: M.l, y: M.t, width: w, height: h, preserveAspectRatio: "none" }, F.svg);
    const Y = yAxis(F, `${V.label} (${V.unit})`, v0, v1, false), X = xAxis(F, { xlabel: `${U.label} (${U.unit})` }, u0, u1);
    const clip = el("clipPath", { id: "clip-field" }, el("defs", {}, F.svg));
    el("rect", { x: M.l, y: M.t, width: w, height: h }, clip);
    const g = el("g", { "clip-path": "url(#clip-field)" }, F.svg), t = scaleBar(F, S);
    const px = i => X(U.values[0] + i * du), py = j => Y(V.values[0] + j * dv);
    const placed = [], labels = [];
    if (st.lines) for (const level of t.at) {
      const found = isoline((i, j) => { const k = cell(i, j); return S.l.code[k] === 0 ? S.value(k) : null; }, nu, nv, level);
      if (!found.length) continue;
      el("path", { d: found.map(([a, b]) => `M${px(a[0]).toFixed(1)} ${py(a[1]).toFixed(1)}L${px(b[0]).toFixed(1)} ${py(b[1]).toFixed(1)}`).join(""), class: "iso" }, g);
      if (found.length < 12) continue;
      let at = null, most = 26; // the label stands where no other is near, nor the border
      for (let n = 0; n < found.length; n += Math.max(1, Math.floor(found.length / 150))) {
        const x = px(found[n][0][0]), y = py(found[n][0][1]);
        const room = Math.min(x - M.l, M.l + w - x, 2 * (y - M.t), 2 * (M.t + h - y), ...placed.map(p => Math.hypot(p[0] - x, 1.6 * (p[1] - y))));
        if (room > most) { most = room; at = [x, y]; }
      }
      if (at) { placed.push(at); labels.push([at, t.text(level)]); }
    }
    for (const [[x, y], text] of labels) el("text", { x, y: y + 4, class: "isotext", "text-anchor": "middle" }, g, text);
    el("rect", { x: M.l, y: M.t, width: w, height: h, class: "box" }, F.svg);
    const mark = el("g", { "clip-path": "url(#clip-field)", "pointer-events": "none" }, F.svg);
    const hit = el("rect", { x: M.l, y: M.t, width: w, height: h, class: "hit" }, F.svg);
    const under = e => {
      const box = F.svg.getBoundingClientRect(), x = (e.clientX - box.left) * F.W / box.width, y = (e.clientY - box.top) * F.H / box.height;
      return cell(Math.max(0, Math.min(nu - 1, Math.floor((x - M.l) / w * nu))), Math.max(0, Math.min(nv - 1, Math.floor((M.t + h - y) / h * nv))));
    };
    hit.addEventListener("pointermove", e => {
      st.over = under(e);
      point();
      const rows = [[spec.axes.map(a => a.name).join(", "), `${where(st.over).map(x => +x.toFixed(2)).join(", ")} ${U.unit}`]], s = S.l.code[st.over], value = S.value(st.over);
      if (s !== 0) rows.push(["no posture", spec.names[s]]);
      else rows.push([S.f.name, value === null ? "–" : `${shown(value)} ${S.f.unit}`]);
      if (s === 0 && S.guess && S.guess[st.over]) rows.push(["", "outside the measured places"]);
      showTip(e, rows);
    });
    hit.addEventListener("pointerleave", () => { st.over = null; hideTip(); point(); });
    hit.addEventListener("click", e => { const k = under(e); st.keep = st.keep === k ? null : k; point(); });
    frameNow = { X, Y, u, v, mark, du, dv, outline: outlineOf(u0, u1, v0, v1, u, v) };
    main.replaceChildren(F.svg);
    bar.querySelectorAll("[data-layer]").forEach(b => b.classList.toggle("on", layers[+b.dataset.layer] === S.l));
    if (slider) { const a = spec.axes[st.normal]; sliderText.textContent = `${a.name} = ${+a.values[st.level].toFixed(1)} ${a.unit}`; }
    keyBox.replaceChildren(key(S));
    point();
  }

  // The map's own rectangle seen from above, where it is one of places.
  function outlineOf(u0, u1, v0, v1, u, v) {
    if (!place) return null;
    const corner = (a, b) => { const p = [...spec.fixed], set = (axis, x) => { p["xyz".indexOf(spec.axes[axis].name)] = x; }; set(u, a); set(v, b); if (volume) set(st.normal, spec.axes[st.normal].values[st.level]); return p; };
    return [corner(u0, v0), corner(u1, v0), corner(u1, v1), corner(u0, v1)];
  }

  function current() {
    if (st.over !== null) return st.over;
    if (st.keep !== null) return st.keep;
    const l = layers[st.layer].best >= 0 ? layers[st.layer] : layers.find(x => x.best >= 0);
    return l ? l.best : 0;
  }

  function point() {
    const k = current(), f = frameNow, at = where(k), here = volume ? Math.floor(k / strides[st.normal]) % shape[st.normal] === st.level : true;
    f.mark.replaceChildren();
    const postures = layers.map((l, i) => ({ q: qOf(l, k), color: i === st.layer ? "#1b2430" : "#8b95a1", opacity: i === st.layer ? 1 : 0.45, own: i === st.layer })).filter(p => p.q)
      .map(p => ({ ...p, points: armPoints(spec.arm, p.q) })).sort((a, b) => a.own - b.own);
    if (place && here) for (const p of postures) if (p.own) {
      const iu = "xyz".indexOf(spec.axes[f.u].name), iv = "xyz".indexOf(spec.axes[f.v].name);
      drawArm(f.mark, p.points.map(x => [f.X(x[iu]), f.Y(x[iv])]), "#1b2430", 0.55, 6);
    }
    if (here) {
      const x = f.X(at[f.u]), y = f.Y(at[f.v]);
      el("circle", { cx: x, cy: y, r: 6, fill: "none", stroke: "#fff", "stroke-width": 4 }, f.mark);
      el("circle", { cx: x, cy: y, r: 6, fill: "none", stroke: "#b3261e", "stroke-width": 2 }, f.mark);
    }
    panel(k, at, postures);
  }

  function panel(k, at, postures) {
    const title = document.createElement("h3"), sub = document.createElement("p");
    title.textContent = spec.axes.map((a, i) => `${a.name} ${+at[i].toFixed(2)}`).join(", ").replaceAll("-", "−") + ` ${spec.axes[0].unit}`;
    sub.className = "joints";
    sub.textContent = st.over !== null ? "under the pointer" : st.keep !== null ? "kept; click it again to let it go" : "best by the quantity postures are chosen by";
    const parts = [title, sub];
    for (const l of layers) if (l.code[k] !== 0) {
      const p = document.createElement("p"), short = l.shortAt(k);
      p.className = "fail"; p.textContent = `${layers.length > 1 ? l.title + ": " : ""}${spec.names[l.code[k]]}${short ? `, ${shown(short, 3)} mm short` : ""}`;
      parts.push(p);
    }
    if (views && hasArm(k)) parts.push(views(postures, frameNow.outline));
    for (const l of layers) { const q = qOf(l, k); if (!q) continue;
      const p = document.createElement("p"), gamma = l.gammaAt(k);
      p.className = "joints";
      p.textContent = `${layers.length > 1 ? l.title + (l.name === "free" && gamma !== null ? ` = ${shown(gamma, 4)}°` : "") + ": " : ""}${spec.arm.joints.map((n, j) => `${n} ${q[j].toFixed(1)}`).join("  ")}`.replaceAll("-", "−");
      parts.push(p);
    }
    const table = document.createElement("table"), head = table.insertRow();
    for (const text of ["", ...(layers.length > 1 ? layers.map(l => l.name === "given" ? "given γ" : "best γ") : ["value"]), "unit"]) { const th = document.createElement("th"); th.textContent = text; if (text) th.className = "n"; head.appendChild(th); }
    for (const f of spec.fields) {
      const row = table.insertRow();
      if (f.key === field().key) row.className = "here";
      row.insertCell().textContent = f.name;
      for (const l of layers) { const c = row.insertCell(); c.className = "n"; c.textContent = l.at[f.key] ? shown(l.at[f.key](k)) : ""; }
      const unit = row.insertCell(); unit.className = "n"; unit.textContent = f.unit;
    }
    side.replaceChildren(...parts);
    numbers.replaceChildren(table);
  }

  function key(S) {
    const box = document.createElement("div");
    box.className = "map-key";
    const swatch = (name, color) => {
      const item = document.createElement("span"), canvas = document.createElement("canvas"), ctx = canvas.getContext("2d");
      canvas.width = 44; canvas.height = 28;
      for (let x = 0; x < 44; x++) for (let y = 0; y < 28; y++) { ctx.fillStyle = `rgb(${color(x, y).join(",")})`; ctx.fillRect(x, y, 1, 1); }
      item.append(canvas, name);
      box.appendChild(item);
    };
    for (const s of S.l.present) if (s !== 0) swatch(spec.names[s], PATTERN[s] || PATTERN[7]);
    if (S.guess) swatch("outside the measured places: a guess", (x, y) => x % 14 < 3 && (y + 7 * (Math.floor(x / 14) % 2)) % 14 < 3 ? WHITE : [38, 130, 142]);
    const note = document.createElement("span");
    note.textContent = S.f.note; note.style.color = "var(--soft)";
    box.appendChild(note);
    return box;
  }

  controls();
  let width = 0;
  new ResizeObserver(() => { if (main.clientWidth && main.clientWidth !== width) { width = main.clientWidth; draw(); } }).observe(main);
  draw();
}
