// A picture without a motion: an arm at one of several postures, the others as shadows, vectors at the tool, a toolpath.
function postureView(host, view) {
  const make = (tag, name, parent, text) => { const e = document.createElement(tag); if (name) e.className = name; if (text) e.textContent = text; if (parent) parent.appendChild(e); return e; };
  const { scene, path, postures } = view, q = postures && levelled(postures.q), count = q ? q.rows : 0;
  const dock = make("div", "dock", host), frame = make("div", "stage", dock), canvas = make("canvas", "", frame), told = make("div", "told", dock);
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", `${view.title} in three dimensions`);
  told.setAttribute("aria-live", "polite");
  if (!count) dock.classList.add("alone");
  const stage = stage3d(canvas, scene);
  if (!stage) {
    frame.replaceChildren();
    make("p", "note", frame, "This browser offers no WebGL, so the picture is left out; tables and drawings hold the same.");
    if (!count) return null;
  }
  const tip = row => FK.origin(FK.tool(scene, FK.motions(scene, row)));
  let arm = null, here = null, needles = [], unit = 1;
  if (stage) {
    for (let k = 0; k < count; k++) stage.include(q.row(k));
    if (path) { const at = unpack(path.at, Float32Array), part = FK.part(scene, FK.motions(scene, q ? q.row(0) : [])); for (let k = 0; k < at.length; k += 3) stage.grow(FK.place(part, [at[k], at[k + 1], at[k + 2]])); pathLines(stage, path); }
    unit = stage.size() / 400;
    const every = Math.max(1, Math.ceil(count / 6));
    for (let k = 0; k < count; k += every) stage.arm({ opacity: 0.09, leads: false }).stand(q.row(k));
    for (let k = 0; k < count; k++) stage.marker(1.3 * unit, "#1552b8").at(tip(q.row(k)));
    if (count) { arm = stage.arm(); here = stage.marker(2 * unit, "#d61f69"); needles = postures.vectors.map(v => [stage.arrow(v.color), unpack(v.at, Float32Array), v.length * 60 * unit]); }
    const bar = make("div", "views", frame), button = (words, label, act) => { const b = make("button", "", bar, words); b.type = "button"; b.title = label; b.setAttribute("aria-label", label); b.onclick = act; };
    for (const name of ["corner", "front", "side", "top"]) button(name[0].toUpperCase() + name.slice(1), `View: ${name}`, () => stage.look(name));
    button("+", "Nearer", () => stage.zoom(0.8));
    button("−", "Farther", () => stage.zoom(1.25));
    stage.look("corner");
    stage.resize();
  }
  const api = { stage, shown: 0, go };
  let input = null, output = null;
  function go(k) {
    api.shown = k;
    const row = q.row(k);
    if (stage) {
      arm.stand(row);
      here.at(tip(row));
      for (const [arrow, at, scale] of needles) { const v = Array.from(at.subarray(3 * k, 3 * k + 3)); arrow.at(tip(row), v.every(Number.isFinite) ? v.map(c => c * scale) : null, 1.1 * unit); }
      stage.draw();
    }
    input.value = k;
    output.textContent = postures.names[k];
    input.setAttribute("aria-valuetext", postures.names[k]);
    told.replaceChildren();
    make("p", "where", told, postures.names[k]);
    const list = make("dl", "", told);
    for (const [name, value] of postures.words[k]) { make("dt", "", list, name); make("dd", "", list, value); }
    const axes = make("table", "joints", told), head = make("tr", "", make("thead", "", axes)), body = make("tr", "", make("tbody", "", axes));
    scene.joints.forEach((j, i) => { make("th", "n", head, j.name).scope = "col"; make("td", "n", body, `${(Math.round(row[i] * j.factor * 10) / 10 + 0).toFixed(1)}${j.unit}`.replace("-", "−")); });
  }
  if (count) {
    const controls = make("div", "controls", host), label = make("label", "", controls, postures.label);
    input = make("input", "", label); output = make("output", "", label);
    input.type = "range"; input.min = 0; input.max = count - 1; input.step = 1;
    input.oninput = () => go(+input.value);
    const key = make("div", "map-key", host);
    for (const v of postures.vectors) { const item = make("span", "", key); make("i", "dot", item).style.background = v.color; item.append(v.name); }
    if (stage) bodySwitches(stage, controls);
    go(0);
  } else if (stage) stage.draw();
  return api;
}
