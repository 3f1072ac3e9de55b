// Steering: what the user wants to hold, dragged on the map or written down, and sent to the planner on this machine.
function steerPlan(data) {
  const spec = data.steering, map = data.map, by = id => document.getElementById(id);
  const wrapped = v => v - 360 * Math.round(v / 360), tidy = v => Math.round(wrapped(v) * 10) / 10;
  const make = (tag, name, parent, text) => { const e = document.createElement(tag); if (name) e.className = name; if (text) e.textContent = text; if (parent) parent.appendChild(e); return e; };
  const state = JSON.parse(JSON.stringify(spec.wishes));
  const same = () => JSON.stringify(tidied(state)) === JSON.stringify(tidied(spec.wishes));
  // Empty mappings say nothing: a wish that was added and taken away again leaves the plan as it is shown.
  const tidied = v => ({ ...v, external: Object.fromEntries(Object.entries(v.external).map(([name, own]) => [name, Object.fromEntries(Object.entries(own).filter(([, at]) => !at || typeof at !== "object" || Object.keys(at).length))]).filter(([, own]) => Object.keys(own).length)) });
  let changed = false, busy = false, plot = null, xs = null;

  // ---- places ---------------------------------------------------------------------------------------------------------
  const chosen = map && (map.lines.find(l => l.name === "chosen") || { y: [] }).y;
  // A station stands for a toolpath point where it is one; others lie between two.
  const stationOf = point => { let best = 0; for (let k = 1; k < map.stations; k++) if (Math.abs(map.point[k] - point) < Math.abs(map.point[best] - point)) best = k; return best; };
  const pointOf = k => Math.round(map.point[k]);
  const gammaAt = (k, phi) => tidy(phi + map.offset[k]), phiAt = (k, gamma) => wrapped(gamma - map.offset[k]);
  const isPoint = k => Math.abs(map.point[k] - pointOf(k)) < 1e-6;
  const stretches = wish => wish.operation ? (spec.operations.find(o => o.label === wish.operation) || { points: [] }).points
    : wish.points ? [wish.points] : wish.point !== undefined ? [[wish.point, wish.point]] : [[0, spec.points - 1]];

  // ---- words ----------------------------------------------------------------------------------------------------------
  const angle = v => minus(`${v}°`);
  const place = w => w.operation ? `operation “${w.operation}”` : w.points && w.points[0] < w.points[1] ? `points ${w.points[0]} to ${w.points[1]}` : w.points ? `point ${w.points[0]}` : w.point !== undefined ? `point ${w.point}` : "whole path";
  const joint = w => w.at_mm !== undefined ? `${w.external} at ${minus(String(w.at_mm))} mm` : w.at_deg !== undefined ? `${w.external} at ${angle(w.at_deg)}`
    : `${w.external} not between ${(w.forbid_mm || w.forbid_deg).map(v => minus(String(v))).join(" and ")} ${w.forbid_mm ? "mm" : "deg"}`;
  const words = w => w.external ? joint(w) : w.gamma_deg !== undefined ? `γ ${angle(w.gamma_deg)}` : w.forbid_deg ? `no γ from ${angle(w.forbid_deg[0])} to ${angle(w.forbid_deg[1])}` : w.prefer_deg !== undefined ? `rather γ ${angle(w.prefer_deg)} (weight ${w.weight ?? 0.1})` : `branch ${w.branch}`;

  // Every wish as [place, words, how it is taken away].
  function listed() {
    const out = state.fixed.map(w => [place(w), words(w), () => state.fixed.splice(state.fixed.indexOf(w), 1)]);
    out.push(...state.steer.map(w => [place(w), words(w), () => state.steer.splice(state.steer.indexOf(w), 1)]));
    for (const [joint, own] of Object.entries(state.external)) for (const unit of ["mm", "deg"]) {
      const at = own[`at_operations_${unit}`] || {};
      for (const label of Object.keys(at)) out.push([`operation “${label}”`, `${joint} at ${minus(String(at[label]))} ${unit}`, () => { delete at[label]; }]);
    }
    return out;
  }

  function touch() {
    changed = !same();
    show();
    if (plot) plot.redraw(false, true);
    if (changed) say("Changed, and not planned yet.", null); else say(spec.message, spec.good);
  }

  function say(text, good) {
    by("status-message").textContent = text.replace(/(^|\s)-(?=\d)/g, "$1−");
    by("status-message").className = good === null ? "" : good ? "pass" : "fail";
  }

  function show() {
    const list = by("wishes"), all = listed();
    list.replaceChildren();
    for (const [where, what, away] of all) {
      const row = make("li", "", list), text = make("span", "", row, `${where}: ${what} `), button = make("button", "", row, "×");
      text.className = "wish";
      button.type = "button";
      button.setAttribute("aria-label", `Take away: ${where}: ${what}`);
      button.onclick = () => { away(); touch(); };
    }
    if (!all.length) make("li", "none", list, "nothing: the plan is free");
    pins();
    by("replan").disabled = busy;
    by("back").disabled = busy || !spec.before;
    by("clear").disabled = busy || !all.length;
    by("save").disabled = by("verify").disabled = busy || changed;
    by("save").title = changed ? "Plan anew first: the file holds the plan that is shown" : "";
  }

  // ---- the form -------------------------------------------------------------------------------------------------------
  const option = (select, value, text) => { const o = make("option", "", select, text); o.value = value; return o; };
  const where = by("where"), what = by("what"), values = by("values");
  spec.operations.forEach((o, n) => option(where, `o${n}`, `operation ${o.label}`));
  option(where, "points", "points");
  option(where, "path", "whole path");
  for (const [value, text] of [["pin", "pin γ"], ["forbid", "forbid γ"], ["prefer", "prefer γ"], ...(spec.branches ? [["branch", "branch"]] : [])]) option(what, value, text);
  spec.axes.forEach((a, n) => { option(what, `a${n}`, `${a.name} stands at`); option(what, `z${n}`, `${a.name} keeps out of`); });
  by("first").max = by("last").max = spec.points - 1;

  function field(name, label, { min = -180, max = 180, step = 0.1, value = 0 } = {}) {
    const input = make("input", "", make("label", "", values, `${label} `));
    Object.assign(input, { type: "number", name, min, max, step, value, required: true });
  }

  const axisMeant = () => /^[az]\d/.test(what.value) ? spec.axes[+what.value.slice(1)] : null;

  function fields() {
    values.replaceChildren();
    by("range").hidden = where.value !== "points";
    const axis = axisMeant();
    if (what.value === "pin") field("gamma", "γ (deg)");
    else if (what.value === "forbid") { field("from", "from (deg)", { value: -30 }); field("to", "to (deg)", { value: 30 }); }
    else if (what.value === "prefer") { field("gamma", "γ (deg)"); field("weight", "weight", { min: 0, max: 1000, value: 0.1 }); }
    else if (what.value === "branch") field("branch", "number", { min: 0, max: spec.branches - 1, step: 1 });
    else if (axis) {
      // Any step: browsers count steps from ``min``, and a limit given in rad is no round number of degrees.
      const ends = { min: axis.lower, max: axis.upper, step: "any" }, middle = Math.round((axis.lower + axis.upper) / 2);
      if (what.value[0] === "z") { field("from", `from (${axis.unit})`, { ...ends, value: Math.ceil(10 * axis.lower) / 10 }); field("to", `to (${axis.unit})`, { ...ends, value: middle }); }
      else field("at", axis.unit, { ...ends, value: middle });
    }
  }
  where.onchange = what.onchange = fields;

  // What a place can have but once: a second wish of the kind takes the first one's place. Different zones add up.
  const once = w => JSON.stringify([place(w), w.external, w.forbid_mm || w.forbid_deg || (w.external ? "at" : w.gamma_deg !== undefined ? "pin" : w.prefer_deg !== undefined ? "prefer" : "branch")]);

  by("wish").onsubmit = evt => {
    evt.preventDefault();
    const v = name => +values.querySelector(`[name=${name}]`).value, op = where.value[0] === "o" ? spec.operations[+where.value.slice(1)].label : null;
    const at = op !== null ? { operation: op } : where.value === "path" ? {} : { points: [Math.min(+by("first").value, +by("last").value), Math.max(+by("first").value, +by("last").value)] };
    const axis = axisMeant(), instead = [];
    const put = wish => { instead.push(...state.steer.filter(w => once(w) === once(wish))); state.steer = state.steer.filter(w => once(w) !== once(wish)); state.steer.push(wish); };
    if (axis && what.value[0] === "z") {
      if (v("from") >= v("to")) { say(`${axis.name} keeps out of a zone from a lower to a higher place.`, false); return; }
      put({ ...at, external: axis.name, [`forbid_${axis.unit}`]: [v("from"), v("to")] });
    } else if (axis && op === null) put({ ...at, external: axis.name, [`at_${axis.unit}`]: v("at") });
    else if (axis) {
      const own = state.external[axis.name] ||= {}, key = `at_operations_${axis.unit}`;
      (own[key] ||= {})[op] = v("at");
    } else if (what.value === "pin" && at.points && at.points[0] === at.points[1]) pin(at.points[0], v("gamma"));
    else if (what.value === "pin") put({ ...at, gamma_deg: v("gamma") });
    else if (what.value === "forbid") put({ ...at, forbid_deg: [v("from"), v("to")] });
    else if (what.value === "prefer") put({ ...at, prefer_deg: v("gamma"), weight: v("weight") });
    else put({ ...at, branch: v("branch") });
    touch();
    if (instead.length && changed) say(`Changed, and not planned yet: instead of “${place(instead[0])}: ${words(instead[0])}”.`, null);
  };

  function pin(point, gamma) {
    state.fixed = state.fixed.filter(w => w.point !== point);
    state.fixed.push({ point, gamma_deg: gamma });
    state.fixed.sort((a, b) => a.point - b.point);
  }

  // ---- the map's control points -----------------------------------------------------------------------------------------
  // Points with an outcome: their handles lie above those beside them.
  const judged = new Set();
  if (data.view && data.view.path.outcome) {
    const codes = bytes(data.view.path.outcome), points = unpack(data.view.path.point, Float32Array);
    codes.forEach((code, n) => { if (code) judged.add(Math.round(points[n])); });
  }
  const HANDLES = 14, EACH = 300; // as many points in view have a handle each: every hole of most jobs, all of them when zoomed

  function pins() {
    if (!plot) return;
    plot.over.querySelectorAll(".pin").forEach(e => e.remove());
    for (const w of state.fixed) handle(stationOf(w.point), w.point, phiAt(stationOf(w.point), w.gamma_deg), true);
    const taken = new Set(state.fixed.map(w => w.point)), free = [];
    for (let k = 0; k < map.stations; k++) if (isPoint(k) && chosen[k] !== null && chosen[k] !== undefined && !taken.has(pointOf(k))) free.push(k);
    const within = free.filter(k => xs[k] >= plot.scales.x.min && xs[k] <= plot.scales.x.max), each = within.length <= EACH;
    const held = state.fixed.map(w => plot.valToPos(xs[stationOf(w.point)], "x")), clear = k => each || held.every(x => Math.abs(plot.valToPos(xs[k], "x") - x) > 14);
    const inView = within.filter(clear), n = each ? inView.length : Math.min(HANDLES, inView.length);
    const tight = n > 1 && plot.over.clientWidth / n < 16;
    for (let i = 0; i < n; i++) { const k = inView[Math.floor((i + 0.5) * inView.length / n)]; handle(k, pointOf(k), chosen[k], false, tight); }
  }

  function handle(k, point, phi, held, tight = false) {
    const dot = make("button", (held ? "pin held" : tight ? "pin tight" : "pin") + (judged.has(point) ? " judged" : ""), plot.over);
    const put = v => {
      phi = wrapped(v);
      dot.style.left = `${plot.valToPos(xs[k], "x")}px`;
      dot.style.top = `${Math.min(Math.max(plot.valToPos(phi, "y"), 8), plot.over.clientHeight - 8)}px`; // whole at the frame
      const text = `Point ${point}: γ ${angle(gammaAt(k, phi))}${held ? ", pinned" : ""}`;
      dot.title = `${text}; drag it, or use the arrow keys${held ? "; delete takes the pin away" : ""}`;
      dot.setAttribute("aria-label", dot.title);
    };
    dot.type = "button";
    dot.dataset.point = point;
    put(phi);
    const settle = () => { pin(point, gammaAt(k, phi)); touch(); const again = plot.over.querySelector(`.pin.held[data-point="${point}"]`); if (again) again.focus({ preventScroll: true }); };
    dot.onpointerdown = evt => {
      evt.preventDefault(); evt.stopPropagation(); hideTip();
      dot.setPointerCapture(evt.pointerId);
      const start = phi, y = evt.clientY;
      dot.onpointermove = move => {
        put(start + plot.posToVal(move.clientY - plot.over.getBoundingClientRect().top, "y") - plot.posToVal(y - plot.over.getBoundingClientRect().top, "y"));
        moved = true;
        if (plot.tellAt) { plot.tellAt(k, phi, move, live.rows); live.follow(dot, k, point, () => phi, move); }
      };
      let moved = false;
      dot.onpointerup = dot.onpointercancel = () => { dot.onpointermove = dot.onpointerup = dot.onpointercancel = null; live.end(dot); hideTip(); if (moved) settle(); };
    };
    for (const kind of ["mousedown", "mousemove", "click", "dblclick"]) dot.addEventListener(kind, evt => evt.stopPropagation()); // none of the map's
    dot.onkeydown = evt => {
      const step = { ArrowUp: 1, ArrowDown: -1, PageUp: 10, PageDown: -10 }[evt.key];
      if (step) { evt.preventDefault(); put(phi + step); settle(); }
      if (held && (evt.key === "Delete" || evt.key === "Backspace")) { evt.preventDefault(); state.fixed = state.fixed.filter(w => w.point !== point); touch(); }
    };
  }

  // Outcome and error of the point under a dragged handle: one question at a time, the newest rotation next.
  const live = { rows: [], asking: null, next: null, held: null,
    follow(dot, k, point, phi, move) {
      if (!spec.live || busy) return;
      live.held = dot;
      live.next = { dot, k, point, phi, move };
      if (!live.asking) live.asking = live.run().finally(() => { live.asking = null; });
    },
    async run() {
      while (live.next) {
        const { dot, k, point, phi, move } = live.next, asked = phi();
        live.next = null;
        let answer = null;
        try { answer = await ask("outcome", { point, phi_deg: asked }); } catch { return; }
        if (live.held !== dot) return;
        live.rows = answer.outcome ? outcomeRows(answer.outcome) : [];
        dot.dataset.outcome = answer.outcome ? answer.outcome.outcome : "";
        plot.tellAt(k, phi(), move, live.rows);
      }
    },
    end(dot) { live.next = live.held = null; live.rows = []; delete dot.dataset.outcome; } };
  const ERROR_WORDS = { across: "error across", along: "error along", axis: "axis error", normal: "error normal" };
  function outcomeRows(o) {
    const color = { pass: "#1c7d43", marginal: "#8a6400", fail: "#b3261e" }[o.outcome] || "#5b6470", rows = [["outcome", o.outcome === "pass" ? "in tolerance" : o.outcome, color]];
    if (o.error_mm !== null) rows.push([ERROR_WORDS[o.error_name], minus(`${o.error_mm.toFixed(3)} mm`) + (o.tolerance_mm === null ? "" : ` of ± ${+o.tolerance_mm.toPrecision(3)} mm`)]);
    else if (o.error_deg !== null) rows.push([ERROR_WORDS[o.error_name], `${o.error_deg.toFixed(3)}°`]);
    if (o.p_in !== null) rows.push(["probability", `${(100 * o.p_in).toFixed(0)} %${o.outcome === "unknown" ? " by deflection alone" : ""}`]);
    return rows;
  }

  // Zones, pins of several points and preferred rotations, where they lie on the map.
  const overlay = u => paint(u, (ctx, b, X, Y) => {
    const edge = k => [k > 0 ? (xs[k] + xs[k - 1]) / 2 : xs[k], k < map.stations - 1 ? (xs[k] + xs[k + 1]) / 2 : xs[k]].map(X);
    const wide = Y(0) - Y(1); // pixels a degree
    for (const w of state.steer.filter(w => !w.external)) for (const [first, last] of stretches(w)) for (let k = 0; k < map.stations; k++) {
      if (map.point[k] < first - 1e-6 || map.point[k] > last + 1e-6) continue;
      const [x0, x1] = edge(k), width = Math.max(x1 - x0, 1.5);
      if (w.forbid_deg) {
        const size = ((w.forbid_deg[1] - w.forbid_deg[0]) % 360 + 360) % 360, from = phiAt(k, w.forbid_deg[0]);
        ctx.fillStyle = "rgba(179, 38, 30, .55)";
        for (const turn of [-360, 0, 360]) ctx.fillRect(x0, Y(from + turn + size), width, size * wide);
      } else if (w.gamma_deg !== undefined || w.prefer_deg !== undefined) {
        ctx.fillStyle = w.gamma_deg !== undefined ? "#d61f69" : "rgba(255, 255, 255, .85)";
        ctx.fillRect(x0, Y(phiAt(k, w.gamma_deg ?? w.prefer_deg)) - 1.5, width, 3);
      }
    }
  });

  onMapDrawn = (u, places) => {
    plot = u; xs = places;
    (u.hooks.draw = u.hooks.draw || []).push(overlay);
    (u.hooks.setScale = u.hooks.setScale || []).push(() => requestAnimationFrame(pins));
    (u.hooks.setSize = u.hooks.setSize || []).push(() => requestAnimationFrame(pins));
    requestAnimationFrame(() => { u.redraw(false, true); pins(); });
  };
  // The map was drawn before this script had its turn.
  const drawn = map && PLOTS.find(u => u.root.parentNode.id === "map");
  if (drawn) onMapDrawn(drawn, map.by_point ? map.rank : map.s);

  // ---- the planner ------------------------------------------------------------------------------------------------------
  async function ask(what, body) {
    const answer = await fetch(what, body === undefined ? {} : { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) });
    return answer.json();
  }

  // Every check of what would be written, those that failed first.
  function checked(answer) {
    const host = by("verified"), rank = { FAILED: 0, "not run": 1, passed: 2 };
    host.replaceChildren();
    const folded = make("details", "", host), title = make("summary", "", folded, `${answer.good ? "Verified" : "Not verified"}: the plan shown `);
    make("span", "", title, `(${answer.checks.length} checks)`);
    folded.open = !answer.good;
    const box = make("div", "scroll", folded), table = make("table", "", box), head = make("tr", "", make("thead", "", table)), body = make("tbody", "", table);
    box.tabIndex = 0; box.setAttribute("role", "group"); box.setAttribute("aria-label", "Checks");
    for (const name of ["Check", "Result", "Found", "Allowed", "Where"]) make("th", "", head, name);
    for (const row of [...answer.checks].sort((a, b) => rank[a[1]] - rank[b[1]])) {
      const tr = make("tr", "", body);
      row.forEach((text, n) => make("td", n === 1 ? { passed: "pass", FAILED: "fail" }[text] || "none" : "", tr, text));
    }
  }

  async function sent(what, body, doing) {
    let saved = "";
    live.next = null;
    if (live.asking) await live.asking;
    busy = true; show(); say(doing, null);
    const clock = setInterval(async () => { try { const p = await ask("progress"); if (busy && p.stage) say(`${doing} ${p.stage}, ${p.seconds.toFixed(0)} s`, null); } catch { /* told by what was sent */ } }, 700);
    try {
      const answer = await ask(what, body);
      say(answer.message, answer.good);
      if (answer.shown) { sessionStorage.setItem("at", String(window.scrollY)); location.reload(); return; }
      if (answer.checks) checked(answer);
      if (answer.saved) { changed = false; saved = answer.message; }
    } catch { say("The planner does not answer; machopt view may have been ended.", false); } finally { clearInterval(clock); busy = false; show(); }
    if (saved) { await sent("verify", {}, "Verifying:"); say(`${by("status-message").textContent} ${saved}`, by("status-message").className === "pass"); }
  }

  by("replan").onclick = () => sent("plan", state, "Planning:");
  by("back").onclick = () => sent("back", {}, "Going back:");
  by("save").onclick = () => sent("save", {}, "Saving:");
  by("verify").onclick = () => sent("verify", {}, "Verifying:");
  by("clear").onclick = () => { state.fixed = []; state.steer = []; for (const own of Object.values(state.external)) { delete own.at_operations_mm; delete own.at_operations_deg; } touch(); };
  fields();
  show();
  if (spec.verified) checked(spec.verified);
  const at = sessionStorage.getItem("at");
  if (at !== null) { sessionStorage.removeItem("at"); requestAnimationFrame(() => window.scrollTo(0, +at)); }
}
