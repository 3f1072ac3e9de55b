// A quantity over two or three axes: colours, isolines, hatching where there is no posture, and the arm under the pointer.
function valuesOf(v) {
  if (!v || !v.level) return () => null;
  const raw = new Uint16Array(bytes(v.level).buffer), a = v.log ? Math.log(v.low) : v.low, b = v.log ? Math.log(v.high) : v.high;
  return k => raw[k] === 65535 ? null : v.log ? Math.exp(a + raw[k] / 65534 * (b - a)) : a + raw[k] / 65534 * (b - a);
}

const LUT = Array.from({ length: 256 }, (_, i) => ramp(i / 255).map(Math.round));
const tenths = v => (Math.round(10 * v) / 10 + 0).toFixed(1); // never -0.0
const inUnit = (v, unit) => unit === "deg" && v !== null ? tenths(v).replace("-", "−") : shown(v); // angles are held to no more
const shown = (v, digits) => v === null ? "–" : String(Math.abs(v) < 1e-9 ? 0 : +v.toPrecision(digits || 4)).replaceAll("-", "−"); // below that it is rounding

function fieldMap(host, spec, onPlace) {
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

  // Colours of the samples, and white where the even course between them goes over a level.
  function image(w, h, nu, nv, S, levels) {
    const canvas = document.createElement("canvas");
    canvas.width = w; canvas.height = h;
    const ctx = canvas.getContext("2d"), img = ctx.createImageData(w, h), px = img.data, step = new Int16Array(w * h).fill(-1);
    const known = k => S.l.code[k] === 0 ? S.value(k) : null, near = {};
    for (let y = 0; y < h; y++) {
      const v = (h - y - 0.5) / h * nv, j = Math.min(nv - 1, Math.floor(v));
      for (let x = 0; x < w; x++) {
        const a = (x + 0.5) / w * nu, i = Math.min(nu - 1, Math.floor(a)), k = cell(i, j), s = S.l.code[k], value = S.value(k);
        let rgb;
        if (s !== 0) rgb = (PATTERN[s] || PATTERN[NOT_CHECKED])(x, y);
        else if (value === null) rgb = WHITE;
        else rgb = S.guess && S.guess[k] && x % 14 < 3 && (y + 7 * (Math.floor(x / 14) % 2)) % 14 < 3 ? WHITE : LUT[Math.round(255 * Math.min(1, Math.max(0, S.good(value))))];
        const i0 = Math.floor(a - 0.5), j0 = Math.floor(v - 0.5);
        if (levels.length && i0 >= 0 && j0 >= 0 && i0 < nu - 1 && j0 < nv - 1) {
          const c = [known(cell(i0, j0)), known(cell(i0 + 1, j0)), known(cell(i0, j0 + 1)), known(cell(i0 + 1, j0 + 1))];
          if (!c.includes(null)) {
            const f = a - 0.5 - i0, g = v - 0.5 - j0, here = (c[0] * (1 - f) + c[1] * f) * (1 - g) + (c[2] * (1 - f) + c[3] * f) * g;
            const n = step[y * w + x] = levels.filter(l => l <= here).length;
            for (const other of [x ? step[y * w + x - 1] : -1, y ? step[(y - 1) * w + x] : -1])
              if (other >= 0 && other !== n) { rgb = WHITE; (near[Math.max(n, other) - 1] ||= []).push([x / w, y / h]); }
          }
        }
        px.set([...rgb, 255], 4 * (y * w + x));
      }
    }
    ctx.putImageData(img, 0, 0);
    return [canvas, near];
  }

  // A level's number stands where no other is near, nor the border.
  function label(ctx, b, near, levels, words) {
    const [u, v] = uv(), at = where(current()), ring = [(at[u] - b.u[0]) / (b.u[1] - b.u[0]) * b.w, (b.v[1] - at[v]) / (b.v[1] - b.v[0]) * b.h];
    const placed = [ring]; // no number where the robot stands: its ring is drawn over it
    for (const [n, at] of Object.entries(near)) {
      let best = null, most = 26;
      for (let i = 0; i < at.length; i += Math.max(1, Math.floor(at.length / 150))) {
        const x = at[i][0] * b.w, y = at[i][1] * b.h;
        const room = Math.min(x, b.w - x, 2 * y, 2 * (b.h - y), ...placed.map(p => Math.hypot(p[0] - x, 1.6 * (p[1] - y))));
        if (room > most) { most = room; best = [x, y]; }
      }
      if (!best) continue;
      placed.push(best);
      ctx.save();
      ctx.textBaseline = "alphabetic"; ctx.lineWidth = 3; ctx.strokeStyle = "#fff"; ctx.font = `11px ${FONT}`; ctx.textAlign = "center"; ctx.lineJoin = "round";
      ctx.strokeText(words[n], b.x + best[0], b.y + best[1] + 4);
      ctx.fillStyle = "#111";
      ctx.fillText(words[n], b.x + best[0], b.y + best[1] + 4);
      ctx.restore();
    }
  }

  let frameNow = null, plotted = null;
  function draw() {
    const [u, v] = uv(), U = spec.axes[u], V = spec.axes[v], nu = shape[u], nv = shape[v], S = source();
    const du = U.values[1] - U.values[0], dv = V.values[1] - V.values[0];
    const u0 = U.values[0] - du / 2, u1 = U.values[nu - 1] + du / 2, v0 = V.values[0] - dv / 2, v1 = V.values[nv - 1] + dv / 2;
    const left = 64, right = 102, top = 20, bottom = 40, bar0 = 16, thick = 15;
    let w = Math.max(320, main.clientWidth) - left - right;
    let h = Math.min(560, Math.max(200, place ? w * (v1 - v0) / (u1 - u0) : Math.min(w * 0.75, w * (v1 - v0) / (u1 - u0))));
    if (place) w = Math.min(w, h * (u1 - u0) / (v1 - v0));
    let levels = [], words = [];
    const name = S.f.unit ? `${S.f.name} (${S.f.unit})` : S.f.name, scale = axis(1, name, { grid: false, log: S.log, size: right - 18, gap: bar0 + thick + 8, ticks: { show: false, size: 0 }, space: 55 });
    const formatValues = scale.values;
    scale.values = (p, at, ...more) => { levels = at; words = formatValues(p, at, ...more); return words; };
    const colours = p => paint(p, (ctx, b) => {
      const [canvas, near] = image(2 * Math.round(b.w), 2 * Math.round(b.h), nu, nv, S, st.lines ? levels : []);
      ctx.drawImage(canvas, b.x, b.y, b.w, b.h);
      frameNow.near = near;
    });
    const scaleBar = p => paint(p, (ctx, b) => {
      const x = b.x + b.w + bar0, n = 60;
      label(ctx, { ...b, u: [u0, u1], v: [v0, v1] }, frameNow.near, levels, words);
      for (let i = 0; i < n; i++) {
        const t = (i + 0.5) / n;
        ctx.fillStyle = `rgb(${ramp(S.f.better === "less" ? 1 - t : t).map(Math.round).join(",")})`;
        ctx.fillRect(x, b.y + b.h * (1 - (i + 1) / n), thick, b.h / n + 0.6);
      }
      ctx.strokeStyle = BOX; ctx.strokeRect(x, b.y, thick, b.h);
      for (const level of levels) { const y = b.y + b.h * (1 - S.part(level)); rule(ctx, x + thick, y, x + thick + 4, y, AXIS); }
      if (S.v.high > S.to * (1 + 1e-9)) write(ctx, `up to ${shown(S.v.high, 3)}`, x, b.y - 6, TICK, "left");
      if (S.v.low < S.from * (1 - 1e-9)) write(ctx, `from ${shown(S.v.low, 3)}`, x, b.y + b.h + 28, TICK, "left"); // below the last number of the axis beside it
    }, { clip: false });
    const fixed = (lo, hi, more) => ({ time: false, auto: false, min: lo, max: hi, range: () => [lo, hi], ...more });
    frameNow = { near: {} };
    if (plotted) plotted.destroy();
    main.replaceChildren();
    const p = plotted = plot(main, {
      width: Math.round(left + w + right), height: Math.round(top + h + bottom), padding: [top, 0, 0, 0], legend: { show: false },
      cursor: { drag: { x: false, y: false }, points: { show: false } },
      scales: { x: fixed(u0, u1), y: fixed(v0, v1), value: fixed(S.from, S.to, { distr: S.log ? 3 : 1 }) },
      axes: [axis(2, `${U.label} (${U.unit})`, { grid: false, space: 54 }), axis(3, `${V.label} (${V.unit})`, { grid: false }), { ...scale, scale: "value" }],
      series: [{}, { paths: () => null, points: { show: false } }, { scale: "value", paths: () => null, points: { show: false } }],
      hooks: { drawClear: [colours], draw: [edge, scaleBar, () => point()] },
    }, [[u0, u1], [null, null], [null, null]]);
    const mark = el("svg", { class: "over" }, p.over);
    const at = e => {
      const [x, y] = under(p, e), n = (value, from, step, count) => Math.max(0, Math.min(count - 1, Math.floor((value - from) / step)));
      return cell(n(p.posToVal(x, "x"), u0, du, nu), n(p.posToVal(y, "y"), v0, dv, nv));
    };
    p.over.addEventListener("mousemove", e => {
      st.over = at(e);
      point();
      const rows = [[spec.axes.map(a => a.name).join(", "), `${where(st.over).map(x => +x.toFixed(2)).join(", ")} ${U.unit}`]], s = S.l.code[st.over], value = S.value(st.over);
      if (s !== 0) rows.push(["no posture", spec.names[s]]);
      else rows.push([S.f.name, value === null ? "–" : `${inUnit(value, S.f.unit)} ${S.f.unit}`]);
      if (s === 0 && S.guess && S.guess[st.over]) rows.push(["", "outside the measured places"]);
      showTip(e, rows);
    });
    p.over.addEventListener("mouseleave", () => { st.over = null; point(); });
    p.over.addEventListener("click", e => { const k = at(e); st.keep = st.keep === k ? null : k; point(); });
    Object.assign(frameNow, { X: x => p.valToPos(x, "x"), Y: y => p.valToPos(y, "y"), u, v, mark, outline: outlineOf(u0, u1, v0, v1, u, v) });
    bar.querySelectorAll("[data-layer]").forEach(b => b.classList.toggle("on", layers[+b.dataset.layer] === S.l));
    if (slider) { const a = spec.axes[st.normal]; sliderText.textContent = `${a.name} = ${+a.values[st.level].toFixed(1)} ${a.unit}`; }
    keyBox.replaceChildren(key(S));
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
    if (onPlace) onPlace(k, at, st.layer, f.outline);
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
      const p = document.createElement("p"), gamma = l.gammaAt(k);  // packed in 65,535 levels: a tenth of a degree is meant
      const turn = g => { const v = Math.round(10 * g) / 10; return v - 360 * Math.ceil((v - 180) / 360); };  // as the table has it
      p.className = "joints";
      p.textContent = `${layers.length > 1 ? l.title + (l.name === "free" && gamma !== null ? ` = ${shown(turn(gamma), 4)}°` : "") + ": " : ""}${spec.arm.joints.map((n, j) => `${n} ${tenths(q[j])}`).join("  ")}`.replaceAll("-", "−");
      parts.push(p);
    }
    const table = document.createElement("table"), head = table.insertRow();
    for (const text of ["", ...(layers.length > 1 ? layers.map(l => l.name === "given" ? "given γ" : "best γ") : ["value"]), "unit"]) { const th = document.createElement(text ? "th" : "td"); th.textContent = text; if (text) th.className = "n"; head.appendChild(th); }
    for (const f of spec.fields) {
      const row = table.insertRow();
      if (f.key === field().key) row.className = "here";
      row.insertCell().textContent = f.name;
      for (const l of layers) { const c = row.insertCell(); c.className = "n"; c.textContent = l.at[f.key] ? inUnit(l.at[f.key](k), f.unit) : ""; }
      const unit = row.insertCell(); unit.className = "n"; unit.textContent = f.unit;
    }
    side.replaceChildren(...parts);
    numbers.replaceChildren(table);
  }

  function key(S) {
    const box = document.createElement("div");
    box.className = "map-key";
    for (const s of S.l.present) if (s !== 0) box.appendChild(swatch(spec.names[s], PATTERN[s] || PATTERN[NOT_CHECKED]));
    if (S.guess) box.appendChild(swatch("outside the measured places: a guess", (x, y) => x % 14 < 3 && (y + 7 * (Math.floor(x / 14) % 2)) % 14 < 3 ? WHITE : [38, 130, 142]));
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
