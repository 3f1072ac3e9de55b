// A picture without a motion: an arm at one of several postures, the others as shadows, vectors at the tool, a toolpath.
// Where the page has a map of postures (`view.around`), that sets the arm by `stand`; the postures here are then those around.
function postureView(host, view) {
  const make = (tag, name, parent, text) => { const e = document.createElement(tag); if (name) e.className = name; if (text) e.textContent = text; if (parent) parent.appendChild(e); return e; };
  const { scene, path, postures } = view, q = postures && levelled(postures.q), count = q ? q.rows : 0, around = view.around && levelled(view.around);
  const dock = make("div", "dock", host), frame = make("div", "stage", dock), canvas = make("canvas", "", frame), details = make("div", "pose-details", dock);
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `${view.title} in three dimensions`);
  details.setAttribute("aria-live", "polite");
  if (!count && !around) dock.classList.add("alone");
  const stage = stage3d(canvas, scene);
  if (!stage) {
    frame.replaceChildren();
    make("p", "note", frame, "This browser offers no WebGL, so the picture is left out; tables and drawings hold the same.");
    if (!count && !around) return null;
  }
  const tip = row => FK.origin(FK.tool(scene, FK.motions(scene, row)));
  let arm = null, shadow = null, here = null, frame3d = null, needles = [], unit = 1;
  if (stage) {
    for (let k = 0; k < count; k++) stage.include(q.row(k));
    for (let k = 0; around && k < around.rows; k++) stage.include(around.row(k));
    if (path) { const at = unpack(path.at, Float32Array), part = FK.part(scene, FK.motions(scene, q ? q.row(0) : [])); for (let k = 0; k < at.length; k += 3) stage.grow(FK.place(part, [at[k], at[k + 1], at[k + 2]])); pathLines(stage, path); }
    unit = stage.size() / 400;
    const every = Math.max(1, Math.ceil(count / 6));
    for (let k = 0; k < count; k += every) stage.arm({ opacity: 0.09, leads: false }).stand(q.row(k));
    for (let k = 0; k < count; k++) stage.marker(1.3 * unit, "#1552b8").at(tip(q.row(k)));
    for (const c of count ? postures.needles : []) needleLines(stage, c, k => tip(q.row(k)), 60 * unit);
    if (around) { shadow = stage.arm({ opacity: 0.18, leads: false }); shadow.stand(null); arm = stage.arm(); here = stage.marker(2 * unit, "#d61f69"); }
    if (count) { arm = stage.arm(); here = stage.marker(2 * unit, "#d61f69"); needles = postures.vectors.map(v => [stage.arrow(v.color), unpack(v.at, Float32Array), v.length * 60 * unit]); }
    const bar = make("div", "views", frame), button = (words, label, act) => { const b = make("button", "", bar, words); b.type = "button"; b.title = label; b.setAttribute("aria-label", label); b.onclick = act; };
    for (const name of ["corner", "front", "side", "top"]) button(name[0].toUpperCase() + name.slice(1), `View: ${name}`, () => stage.look(name));
    button("+", "Nearer", () => stage.zoom(0.8));
    button("−", "Farther", () => stage.zoom(1.25));
    stage.look("corner");
    stage.resize();
  }
  const api = { stage, shown: 0, go, stand };
  let input = null, output = null;
  function go(k) {
    api.shown = k;
    const row = q.row(k);
    if (stage) {
      for (const [arrow, at, scale] of needles) { const v = Array.from(at.subarray(3 * k, 3 * k + 3)); arrow.at(tip(row), v.every(Number.isFinite) ? v.map(c => c * scale) : null, 1.1 * unit); }
    }
    input.value = k;
    output.textContent = postures.names[k];
    input.setAttribute("aria-valuetext", postures.names[k]);
    stand(row, postures.names[k], postures.words[k]);
  }
  // The arm at a posture (null: there is none), another as its shadow, a rectangle of the map, and its description.
  function stand(row, name, words, other = null, outline = null) {
    if (stage) {
      arm.stand(row);
      here.at(row && tip(row));
      if (shadow) shadow.stand(other);
      if (frame3d) frame3d.removeFromParent();
      frame3d = outline && stage.lines(outline.flatMap((p, i) => [...p, ...outline[(i + 1) % outline.length]]), null, 2, stage.root);
      stage.draw();
    }
    details.replaceChildren();
    make("p", "where", details, name);
    const list = make("dl", "", details);
    for (const [what, value] of words) { make("dt", "", list, what); make("dd", "", list, value); }
    if (!row) return;
    const axes = make("table", "joints", details), head = make("tr", "", make("thead", "", axes)), body = make("tr", "", make("tbody", "", axes));
    scene.joints.forEach((j, i) => { make("th", "n", head, j.name).scope = "col"; make("td", "n", body, `${(Math.round(row[i] * j.factor * 10) / 10 + 0).toFixed(1)}${j.unit}`.replace("-", "−")); });
  }
  if (count) {
    const controls = make("div", "controls", host), label = make("label", "", controls, postures.label);
    input = make("input", "", label); output = make("output", "", label);
    input.type = "range"; input.min = 0; input.max = count - 1; input.step = 1;
    input.oninput = () => go(+input.value);
    if (count < 2) label.style.display = "none"; // nothing to choose from
    const key = make("div", "map-key", host);
    for (const v of postures.vectors) { const item = make("span", "", key); make("i", "dot", item).style.background = v.color; item.append(v.name); }
    if (stage) bodySwitches(stage, controls);
    go(0);
  } else if (stage) { if (around) bodySwitches(stage, make("div", "controls", host)); stage.draw(); }
  return api;
}

// Many vectors at once, as lines from the tips of their postures.
function needleLines(stage, spec, tip, size) {
  const of = unpack(spec.of, Int32Array), at = unpack(spec.at, Float32Array), points = [];
  of.forEach((k, i) => { const p = tip(k); points.push(...p, ...p.map((c, j) => c + at[3 * i + j] * spec.length * size)); });
  const linear = c => c <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4, rgb = [1, 3, 5].map(i => linear(parseInt(spec.color.slice(i, i + 2), 16) / 255));
  if (points.length) stage.lines(points, points.map((_, i) => rgb[i % 3]), 2, stage.root);
}
