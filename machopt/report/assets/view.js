// The robot on its path: one place at a time, set by slider, map, curves, tables or the picture itself, and described in words.
function robotView(host, data) {
  const { scene, path, stations, motion, corrected } = data.view, map = data.map;
  const at3 = unpack(path.at, Float32Array), pathPoint = unpack(path.point, Float32Array);
  const P = pathPoint.length, deg = 180 / Math.PI, wrap = v => v - 360 * Math.round(v / 360);
  const grid = stations && levelled(stations.q), chosen = stations && levelled(stations.chosen);
  const move = motion && { time: unpack(motion.time, Float32Array), q: levelled(motion.q), point: unpack(motion.point, Float32Array), s: unpack(motion.s, Float32Array), phi: unpack(motion.phi, Float32Array), gamma: unpack(motion.gamma, Float32Array), tool: motion.tool };
  const float6 = name => stations && stations[name] && unpack(stations[name], Float32Array);
  const soft = float6("compliance"), springs = float6("k"), force = float6("force"), bend = float6("bend");
  const status = map && bytes(map.status), level = map && new Uint16Array(bytes(map.index).buffer), R = map ? map.rotations : 0, N = map ? map.stations : 0;
  const indexAt = cell => level[cell] === 65535 ? null : map.lowest + level[cell] / 65534 * (map.highest - map.lowest);
  const home = firstRow(chosen) || (move && move.q.row(0)) || firstRow(grid) || scene.joints.map(() => 0);

  function firstRow(rows) {
    for (let k = 0; rows && k < rows.rows; k++) { const q = rows.row(k); if (q) return q; }
    return null;
  }

  // The page's part: canvas, controls, words.
  const make = (tag, name, parent, text) => { const e = document.createElement(tag); if (name) e.className = name; if (text) e.textContent = text; if (parent) parent.appendChild(e); return e; };
  const dock = make("div", "dock", host), frame = make("div", "stage", dock), canvas = make("canvas", "", frame), details = make("div", "pose-details", dock);
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "img");
  canvas.setAttribute("aria-label", "Robot, cell and toolpath in three dimensions; the text beside it says what it shows");
  const bar = make("div", "views", frame), button = (words, label, act, parent = bar) => { const b = make("button", "", parent, words); b.type = "button"; b.setAttribute("aria-label", label); b.title = label; b.onclick = act; return b; };
  const stage = stage3d(canvas, scene);
  const controls = make("div", "controls", host);
  const ranges = {};
  function range(name, words, max, act) {
    const label = make("label", "", controls, words), input = make("input", "", label), value = make("output", "", label);
    input.type = "range"; input.min = 0; input.max = max; input.step = 1; input.value = 0;
    input.oninput = () => act(+input.value);
    ranges[name] = { input, say(v, text) { input.value = v; value.textContent = text; input.setAttribute("aria-valuetext", text); } };
  }

  // What the picture holds beside the arm.
  let arm, ghost, here, ball, needle, load, unit = 1;
  if (stage) {
    stage.include(home);
    const part = FK.part(scene, FK.motions(scene, home));
    for (let k = 0; k < P; k++) stage.grow(FK.place(part, onPart(k)));
    arm = stage.arm();
    ghost = stage.arm({ opacity: 0.16 });
    const span = stage.size();
    unit = span / 400;
    here = stage.marker(1.6 * unit, "#d61f69");
    ball = stage.ellipsoid("#2b8cff");
    needle = stage.arrow("#d61f69");
    pathLines(stage, path);
    if (path.outcome) stage.after.push(outcomeLabels());
    for (const [name, words] of [["corner", "Corner"], ["front", "Front"], ["side", "Side"], ["top", "Top"]]) button(words, `View: ${name}`, () => stage.look(name));
    button("Tool", "View: close to the tool", () => { const M = FK.motions(scene, shown.q || home), w = FK.place(scene.root, FK.origin(FK.tool(scene, M))); stage.look("corner", w, span / 4); });
    button("+", "Nearer", () => stage.zoom(0.8));
    button("−", "Farther", () => stage.zoom(1.25));
    stage.look("corner");
    stage.resize();
    canvas.addEventListener("click", pickOnPath);
  } else {
    frame.replaceChildren();
    make("p", "note", frame, "This browser offers no WebGL, so the picture is left out. Place and rotation can be set all the same: by the controls, on the map and on the curves; the text says what is there.");
  }

  // The worst points out of tolerance in words, in the picture: where no other label is near.
  function outcomeLabels() {
    const codes = bytes(path.outcome), chances = unpack(path.p_in, Float32Array), rank = { fail: 0, unknown: 1, marginal: 2 }, LABELS = 8, NEAR = [76, 18];
    const box = make("div", "outcome-labels", frame), word = k => path.outcomes[codes[k] - 1];
    const worst = Array.from(codes.keys()).filter(k => codes[k] && word(k) !== "pass").sort((a, b) => rank[word(a)] - rank[word(b)] || (chances[a] || 0) - (chances[b] || 0) || a - b).slice(0, 400);
    const spans = Array.from({ length: Math.min(LABELS, worst.length) }, () => make("span", "", box));
    box.setAttribute("aria-hidden", "true"); // the text beside the picture says it of every point
    return () => {
      const part = partNow(), taken = [];
      for (const k of worst) {
        if (taken.length === spans.length) break;
        const p = stage.onCanvas(FK.place(part, onPart(k)));
        if (!p || p[0] < 0 || p[1] < 0 || p[0] > canvas.clientWidth - 60 || p[1] > canvas.clientHeight || taken.some(q => Math.abs(q[0] - p[0]) < NEAR[0] && Math.abs(q[1] - p[1]) < NEAR[1])) continue;
        const span = spans[taken.length], text = `${word(k)} ${whole(pathPoint[k])}`;
        if (span.textContent !== text) span.textContent = text;
        span.className = word(k);
        span.style.transform = `translate(${p[0] + 7}px, ${p[1] - 8}px)`;
        taken.push(p);
      }
      spans.forEach((span, n) => { span.hidden = n >= taken.length; });
    };
  }

  function onPart(k) { return [at3[3 * k], at3[3 * k + 1], at3[3 * k + 2]]; }

  function key() {
    const box = make("div", "map-key", host);
    if (path.known) {
      const scale = make("div", "scale", box), ends = path.large_is_good ? [path.from, path.to] : [path.to, path.from];
      make("span", "", scale, softEnd(ends[0], pathValue.reduce((a, v) => Number.isFinite(v) ? path.large_is_good ? Math.min(a, v) : Math.max(a, v) : a, ends[0])));
      make("div", "bar", scale).style.background = `linear-gradient(to right, ${RAMP.map(c => `rgb(${c.join(",")})`).join(",")})`;
      make("span", "", scale, `stiff ${+ends[1].toPrecision(3)}: ${path.label}`);
    }
    if (path.outcome) {
      const codes = bytes(path.outcome), counts = path.outcomes.map((word, n) => [word, codes.reduce((sum, code) => sum + (code === n + 1), 0)]);
      for (const [word, count] of counts) if (count) {
        const entry = make("span", "", box), dot = make("i", "outcome-dot", entry);
        dot.style.background = `rgb(${OUTCOME_COLORS[word].join(",")})`;
        entry.append(`${word === "pass" ? "in tolerance" : word} ${count.toLocaleString("en")}`);
      }
    }
    if (soft && chosen && firstRow(chosen)) make("span", "", box, "blue body: where a unit force from each side would push the tip (compliance)");
    if (force && chosen && firstRow(chosen)) make("span", "", box, "red arrow: deflection under the process force, enlarged");
    make("span", "", box, `bodies as they are checked for collisions, drawn with ${scene.bodies.reduce((n, b) => n + bytes(b.faces).length / (b.wide ? 12 : 6), 0).toLocaleString("en")} of their ${scene.triangles.toLocaleString("en")} triangles`);
  }

  // ---- places -------------------------------------------------------------------------------------------------------
  // A place: q or null, station k and rotation r of the map where there are, time, path length, point, φ and γ in degrees.
  let shown = { q: home };
  const nearestStation = point => {
    if (!map || !Number.isFinite(point)) return -1;
    let best = 0;
    for (let k = 1; k < N; k++) if (Math.abs(map.point[k] - point) < Math.abs(map.point[best] - point)) best = k;
    return best;
  };
  const rotationOf = phi => Math.max(0, Math.min(R - 1, Math.round((wrap(phi - map.rotation[0]) + 360) % 360 / (360 / R)) % R));
  const chosenPhi = k => { const line = map && map.lines.find(l => l.name === "chosen"); return line ? line.y[k] : null; };

  function atTime(t) {
    const n = move.time.length;
    let k = 0;
    for (let a = 0, b = n - 1; a <= b;) { const m = a + b >> 1; if (move.time[m] <= t) { k = m; a = m + 1; } else b = m - 1; }
    const next = Math.min(k + 1, n - 1), f = next > k ? (t - move.time[k]) / (move.time[next] - move.time[k]) : 0;
    const a = move.q.row(k), b = move.q.row(next), near = f < 0.5 ? k : next;
    const mix = values => Number.isFinite(values[k]) && Number.isFinite(values[next]) ? values[k] + f * (values[next] - values[k]) : values[near];
    const point = mix(move.point), station = nearestStation(point);
    // between two samples an angle may pass ±180°: then the nearer one is shown
    const angle = values => Math.abs(values[next] - values[k]) < 180 ? mix(values) : values[near];
    return { q: a.map((v, j) => v + f * (b[j] - v)), t, k: station, r: -1, point, s: mix(move.s), phi: angle(move.phi), gamma: wrap(angle(move.gamma)), chosen: true, tool: move.tool ? move.tool[near] : 0 };
  }

  // When the motion is at a toolpath point: the first sample that has reached it.
  function timeOf(point) {
    for (let k = 0; k < move.time.length; k++) if (move.point[k] >= point - 1e-4) {
      const before = Math.max(k - 1, 0), span = move.point[k] - move.point[before];
      if (!(move.point[before] <= point) && move.point[k] - point > 0.05) return null; // comes from a rapid move between two samples
      return span > 0 ? move.time[k] - (move.point[k] - point) / span * (move.time[k] - move.time[before]) : move.time[k];
    }
    return null;
  }

  function atCell(k, r) {
    const phi = map.rotation[r], point = map.point[k];
    return { q: grid.row(k * R + r), t: move ? timeOf(point) : null, k, r, point, s: map.s[k], phi, gamma: map.offset ? wrap(phi + map.offset[k]) : NaN, chosen: false };
  }

  function atPoint(point) {
    const t = move ? timeOf(point) : null, k = nearestStation(point);
    const planned = k >= 0 && Math.abs(map.point[k] - point) < 1e-3 && chosenPhi(k) !== null ? chosen.row(k) : null; // as the tables have it
    if (t !== null) return planned ? { ...atTime(t), q: planned, point, phi: chosenPhi(k), gamma: wrap(chosenPhi(k) + map.offset[k]) } : atTime(t);
    if (k < 0) return shown;
    const phi = chosenPhi(k), q = chosen.row(k);
    if (q) return { q, t: null, k, r: -1, point, s: map.s[k], phi: phi ?? NaN, gamma: phi === null ? NaN : wrap(phi + map.offset[k]), chosen: true };
    return { ...atCell(k, bestCell(k)), point };
  }

  // Where no posture reaches, the arm stands as a shadow where it last could.
  function nearestPosture(k) {
    for (let d = 0; d < N; d++) for (const at of [k - d, k + d]) { const q = at >= 0 && at < N && chosen.row(at); if (q) return q; }
    return home;
  }

  // The rotation that came farthest where none was chosen.
  function bestCell(k) {
    let best = 0;
    for (let r = 1; r < R; r++) if (grid.row(k * R + r) && (!grid.row(k * R + best) || status[k * R + r] > status[k * R + best])) best = r;
    return best;
  }

  function go(place, { quiet = false } = {}) {
    shown = place;
    const tool = toolOf(place);
    if (scene.tools.length) scene.tool = scene.tools[tool].at;
    const M = place.q && FK.motions(scene, place.q), tip = M && FK.origin(FK.tool(scene, M));
    const own = place.k >= 0 && soft && place.chosen ? Array.from(soft.slice(6 * place.k, 6 * place.k + 6)) : null;
    const atStation = place.k >= 0 && Math.abs(map.point[place.k] - place.point) < 1.01, known = own && Number.isFinite(own[0]) && cuttingNow(place);
    const exact = known && (atStation || stations.terms.length > 0); // between stations the joints' springs tell it, unless they are not all
    const k6 = place.k >= 0 && springs ? Array.from(springs.slice(6 * place.k, 6 * place.k + 6)) : null;
    const base = M && FK.baseOf(scene, M), three = (values, k) => FK.turn(base, Array.from(values.slice(3 * k, 3 * k + 3)));
    const C = exact ? FK.spread(base, [own[0], own[3], own[4], own[3], own[1], own[5], own[4], own[5], own[2]]) : M && k6 && cuttingNow(place) ? FK.compliance(scene, M, k6) : null;
    const f = C && force ? three(force, place.k) : null;
    const d = f && (exact && bend ? three(bend, place.k) : FK.times(C, f));
    if (stage) {
      arm.hold(tool);
      ghost.hold(tool);
      arm.stand(place.q);
      ghost.stand(!place.q ? nearestPosture(place.k) : !place.chosen && chosen && place.k >= 0 ? chosen.row(place.k) : null);
      here.at(place.k >= 0 && Number.isFinite(place.point) ? onPath(place.point) : tip);
      ball.at(tip, C, C ? 40 * unit / FK.eigenvalues(C)[0] : 1);
      needle.at(tip, d && d.map(v => v / Math.hypot(...d) * 40 * unit * Math.min(2, Math.hypot(...d) / worstBend)), 1.1 * unit);
      stage.draw();
    }
    if (move) ranges.time.say(Math.round((place.t ?? 0) / move.time[move.time.length - 1] * 1000), place.t === null || place.t === undefined ? "–" : `${place.t.toFixed(1)} s`);
    else if (ranges.station) ranges.station.say(Math.max(place.k, 0), `point ${whole(place.point)}`);
    if (ranges.phi) ranges.phi.say(place.r >= 0 ? place.r : Number.isFinite(place.phi) ? rotationOf(place.phi) : 0, angleText(place.phi));
    moveHere({ path: Number.isFinite(place.s) ? place.s : null, station: place.k >= 0 ? place.k : null, time: place.t ?? null, phi: Number.isFinite(place.phi) ? place.phi : null });
    tell(place, C, d, exact);
    if (!quiet) float();
  }

  const worstBend = (() => { let most = 0; for (let k = 0; bend && k < bend.length; k += 3) { const v = Math.hypot(bend[k], bend[k + 1], bend[k + 2]); if (v > most) most = v; } return most || 1e-4; })();
  // In a cut: at a station, or between two of them where every point of the path between cuts.
  const cutting = bytes(path.cutting), pathValue = unpack(path.value, Float32Array);
  const pathRow = point => { let k = 0; while (k < P - 1 && pathPoint[k] < point - 1e-3) k++; return k; };
  const cuttingNow = place => {
    if (place.k < 0 || !Number.isFinite(place.point)) return false;
    const from = map.point[place.k], to = place.point;
    if (Math.abs(from - to) < 1.01) return true;
    for (let k = pathRow(Math.min(from, to)) + 1; k <= pathRow(Math.max(from, to)); k++) if (!(cutting[k >> 3] >> (k & 7) & 1)) return false;
    return true;
  };
  // The deflection that points.csv has at a toolpath point of the chosen plan, mm; where a path is coloured otherwise, more is better.
  const statedDeflection = place => {
    if (!place.chosen || path.large_is_good || !cuttingNow(place)) return NaN;
    const k = pathRow(place.point);
    return Math.abs(pathPoint[k] - place.point) < 1e-3 ? pathValue[k] : NaN;
  };

  // Whether the tolerances hold at a toolpath point of the chosen plan.
  const outcomeCode = path.outcome && bytes(path.outcome), chance = path.outcome && unpack(path.p_in, Float32Array);
  const outcomeAt = place => {
    if (!outcomeCode || !place.chosen || !Number.isFinite(place.point)) return null;
    const k = pathRow(place.point), word = outcomeCode[k] && Math.abs(pathPoint[k] - place.point) < 1e-3 && path.outcomes[outcomeCode[k] - 1];
    if (!word) return null;
    const p = Number.isFinite(chance[k]) ? `, probability ${(100 * chance[k]).toFixed(0)} %` : "";
    return { word, text: `${word}${p}${path.cause[k] && word !== "pass" ? `, ${path.cause[k]}` : ""}` };
  };

  // Which of the scene's tools is on: as the motion says, else as the nearest place of the map.
  const toolOf = place => place.tool ?? (stations && stations.tool && place.k >= 0 ? stations.tool[place.k] : 0);

  function partNow() { return FK.part(scene, FK.motions(scene, shown.q || home)); }

  function onPath(point) {
    let k = 0;
    while (k < P - 1 && pathPoint[k + 1] <= point) k++;
    const next = Math.min(k + 1, P - 1), span = pathPoint[next] - pathPoint[k], f = span > 0 ? Math.min(1, (point - pathPoint[k]) / span) : 0;
    const a = onPart(k), b = onPart(next);
    return FK.place(partNow(), a.map((v, i) => v + f * (b[i] - v)));
  }

  function pickOnPath(evt) {
    const box = canvas.getBoundingClientRect(), x = evt.clientX - box.left, y = evt.clientY - box.top;
    const part = partNow();
    let best = -1, far = 12;
    for (let k = 0; k < P; k++) {
      const p = stage.onCanvas(FK.place(part, onPart(k)));
      if (p && Math.hypot(p[0] - x, p[1] - y) < far) { far = Math.hypot(p[0] - x, p[1] - y); best = k; }
    }
    if (best >= 0) go(atPoint(pathPoint[best]));
  }

  // ---- words --------------------------------------------------------------------------------------------------------
  const whole = v => !Number.isFinite(v) ? "–" : Math.abs(v - Math.round(v)) < 1e-3 ? String(Math.round(v)) : v.toFixed(2);
  const angleText = v => Number.isFinite(v) ? minus(`${(Math.abs(v) < 0.05 ? 0 : v).toFixed(1)}°`) : "–";

  function tell(place, C, d, exact) {
    details.replaceChildren();
    const title = make("p", "where", details), list = make("dl", "", details);
    const row = (name, value, kind) => { make("dt", "", list, name); make("dd", kind || "", list, value); };
    title.textContent = `Point ${whole(place.point)}` + (Number.isFinite(place.s) ? `, path length ${place.s.toFixed(1)} mm` : "") + (Number.isFinite(place.t) && place.t !== null ? `, ${place.t.toFixed(2)} s` : "");
    if (scene.tools.length) row("Tool", scene.tools[toolOf(place)].name);
    row("Rotation", `φ ${angleText(place.phi)}, γ ${angleText(place.gamma)}${place.r >= 0 ? (chosen.row(place.k) ? ", not the chosen one" : ", none was chosen here") : place.chosen ? ", chosen" : ""}`);
    const cell = place.r >= 0 ? place.k * R + place.r : -1;
    if (cell >= 0) {
      const code = status[cell], value = indexAt(cell);
      row("State", code === NOT_CHECKED ? "feasible, collisions not checked" : map.names[code], code === 0 ? "pass" : code === NOT_CHECKED ? "" : "fail");
      if (value !== null) row(map.label[0].toUpperCase() + map.label.slice(1), `${+value.toPrecision(4)} ${map.unit}`);
    }
    const why = (data.view.reasons || []).find(w => Math.abs(w.point - place.point) < 0.51);
    if (why) {
      row("Why", why.reason, "fail");
      row("Would help", why.help);
      row("Place", minus(`x ${why.at[0].toFixed(1)}, y ${why.at[1].toFixed(1)}, z ${why.at[2].toFixed(1)} mm`));
    }
    if (!place.q) { row("Axes", "no posture of the arm reaches this place with this rotation", "fail"); }
    const same = cell >= 0 && indexAt(cell) !== null && map.label === "deflection"; // shown above, with all terms
    if (Number.isFinite(statedDeflection(place))) row("Deflection", `${statedDeflection(place).toFixed(3)} mm`);
    else if (d && !same) row("Deflection", `${(1e3 * Math.hypot(...d)).toFixed(3)} mm${exact || !stations.terms.length ? "" : " by the joints' springs alone"}`);
    const tolerance = outcomeAt(place);
    if (tolerance) row("Tolerance", tolerance.text, tolerance.word === "pass" ? "pass" : tolerance.word === "fail" ? "fail" : "");
    if (C) {
      const [most, , least] = FK.eigenvalues(C);
      row("Stiffness", `${(1e-6 / most).toPrecision(3)} N/µm softest, ${(1e-6 / least).toPrecision(3)} N/µm stiffest way`);
    }
    if (place.q) {
      const margins = scene.joints.map((j, i) => [Math.min(j.lower === null ? Infinity : place.q[i] - j.lower, j.upper === null ? Infinity : j.upper - place.q[i]) * j.factor, j]);
      const [left, joint] = margins.reduce((a, b) => (b[0] < a[0] ? b : a));
      if (Number.isFinite(left)) row("Joint limits", left < 0 ? `${joint.name} is ${(-left).toFixed(1)}${joint.unit} beyond its limit` : `${left.toFixed(1)}${joint.unit} left on ${joint.name}`, left < 0 ? "fail" : "");
      if (place.chosen && cuttingNow(place)) {
        const k = place.k, near = stations.clearance[k];
        if (stations.singularity[k] !== null) row("Singularity", `${stations.singularity[k].toFixed(1)}° away`);
        if (near !== null) row("Clearance", `${near.toFixed(1)} mm${stations.names[stations.nearest[k]] ? ` (${stations.names[stations.nearest[k]]})` : ""}`);
      } else if (place.r >= 0) row("Clearance", "measured at the chosen rotation only");
      let head, body;
      scene.joints.forEach((j, i) => {
        if (i % 6 === 0) { const axes = make("table", "joints", details); head = make("tr", "", make("thead", "", axes)); body = make("tr", "", make("tbody", "", axes)); }
        make("th", "n", head, j.name).scope = "col"; make("td", margins[i][0] < 0 ? "n fail" : "n", body, minus(`${(Math.round(place.q[i] * j.factor * 10) / 10 + 0).toFixed(1)}${j.unit}`));
      });
      if (corrected) make("p", "lead", details, "True joint angles; the robot receives corrected values.");
    }
    if (place.r >= 0 && chosen.row(place.k)) {
      const back = make("button", "", details, "back to the chosen rotation");
      back.type = "button";
      back.onclick = () => go(atPoint(place.point));
    }
  }

  // ---- controls -----------------------------------------------------------------------------------------------------
  let playing = 0;
  if (move) {
    const end = move.time[move.time.length - 1], play = button("▶ Play", "Play the motion", () => (playing ? stop() : start()), controls), pace = make("select", "", controls);
    pace.setAttribute("aria-label", "Speed");
    for (const n of [1, 5, 20, 100]) { const o = make("option", "", pace, `${n}×`); o.value = n; }
    pace.value = end > 120 ? "20" : "5";
    const stop = () => { cancelAnimationFrame(playing); playing = 0; play.textContent = "▶ Play"; play.setAttribute("aria-label", "Play the motion"); };
    const start = () => {
      let last = null, t = shown.t && shown.t < end - 1e-3 ? shown.t : 0;
      play.textContent = "❚❚ Stop"; play.setAttribute("aria-label", "Stop the motion");
      const step = now => {
        if (last !== null) t = Math.min(end, t + (now - last) / 1000 * pace.value);
        last = now;
        go(atTime(t), { quiet: true });
        if (t < end && playing) playing = requestAnimationFrame(step); else stop();
      };
      playing = requestAnimationFrame(step);
    };
    range("time", "Time", 1000, v => { stop(); go(atTime(v / 1000 * end), { quiet: true }); });
  } else if (map) range("station", "Place", N - 1, v => go(atPoint(map.point[v]), { quiet: true }));
  if (grid) range("phi", "Rotation φ", R - 1, v => { if (shown.k >= 0) go(atCell(shown.k, v), { quiet: true }); });
  if (stage) bodySwitches(stage, controls);
  key();

  // Out of sight, the picture comes along in a corner of the window once it has been asked for.
  let away = false;
  const close = button("×", "Close the small picture", () => dock.classList.remove("float"), dock);
  close.classList.add("close");
  function float() {
    if (!away || !stage) return;
    host.style.minHeight = `${host.offsetHeight}px`;
    dock.classList.add("float");
  }
  new IntersectionObserver(entries => {
    away = entries[entries.length - 1].intersectionRatio < 0.3;
    if (!away) { dock.classList.remove("float"); host.style.minHeight = ""; }
  }, { threshold: [0, 0.3, 0.6] }).observe(host);

  onPick = pick => {
    if (pick.kind === "map") go(atCell(pick.k, pick.r));
    else if (pick.kind === "point") go(atPoint(pick.point));
    else if (pick.kind === "time" && move) go(atTime(Math.max(0, Math.min(pick.time, move.time[move.time.length - 1]))));
  };
  document.addEventListener("click", evt => {
    const link = evt.target.closest && evt.target.closest("a[data-point]");
    if (!link) return;
    go(atPoint(+link.dataset.point), { quiet: true }); // the link itself goes to the picture
  });
  rotationAtTime = t => { if (!move) return []; const p = atTime(t); return Number.isFinite(p.gamma) ? [["φ, γ", `${angleText(p.phi)}, ${angleText(p.gamma)}`]] : []; };
  go(data.view.start !== null && map ? atPoint(data.view.start) : move ? atTime(0) : map ? atPoint(map.point[0]) : shown, { quiet: true });
  return { go, atTime, atCell, atPoint, get shown() { return shown; }, stage };
}
