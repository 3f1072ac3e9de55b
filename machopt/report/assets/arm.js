// The arm as a stick figure: joint lines carried by the posture, seen from the side and from above.
const sub = (a, b) => a.map((v, i) => v - b[i]), add = (a, b) => a.map((v, i) => v + b[i]), dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const times = (a, s) => a.map(v => v * s), norm = a => Math.sqrt(dot(a, a));

function turn(axis, angle, v) {
  const c = Math.cos(angle), s = Math.sin(angle);
  return add(add(times(v, c), times(cross(axis, v), s)), times(axis, dot(axis, v) * (1 - c)));
}

// Base, a point on each joint axis, flange and TCP in mm, for joint angles in degrees.
function armPoints(arm, q) {
  const carry = (p, last) => {
    for (let i = last; i >= 0; i--) p = add(arm.point[i], turn(arm.axis[i], q[i] * Math.PI / 180, sub(p, arm.point[i])));
    return p;
  };
  return [arm.base, ...arm.point.map((p, i) => carry(p, i - 1)), carry(arm.flange, 5), carry(arm.tcp, 5)];
}

function sideDirection(arm, points) {
  const up = arm.up;
  for (const k of [8, 4, 3]) { // TCP, else wrist, else elbow: whichever stands off axis 1
    const d = sub(points[k], arm.base), flat = sub(d, times(up, dot(d, up)));
    if (norm(flat) > 50) return times(flat, 1 / norm(flat));
  }
  return [1, 0, 0];
}

function drawArm(svg, at, color, opacity, width) {
  const path = at.slice(0, -1).map(([x, y], i) => (i ? "L" : "M") + x.toFixed(1) + " " + y.toFixed(1)).join("");
  const g = el("g", { opacity, "pointer-events": "none" }, svg), tool = at.slice(-2).map(([x, y], i) => (i ? "L" : "M") + x.toFixed(1) + " " + y.toFixed(1)).join("");
  el("path", { d: path, fill: "none", stroke: "#fff", "stroke-width": width + 3, "stroke-linejoin": "round", "stroke-linecap": "round" }, g);
  el("path", { d: path, fill: "none", stroke: color, "stroke-width": width, "stroke-linejoin": "round", "stroke-linecap": "round" }, g);
  el("path", { d: tool, fill: "none", stroke: "#fff", "stroke-width": width / 2 + 3, "stroke-linecap": "round" }, g);
  el("path", { d: tool, fill: "none", stroke: "#d9730d", "stroke-width": Math.max(2, width / 2), "stroke-linecap": "round" }, g);
  for (const [x, y] of at.slice(1, -2)) el("circle", { cx: x, cy: y, r: width * 0.62, fill: "#fff", stroke: color, "stroke-width": 1.4 }, g);
  const [x, y] = at[at.length - 1];
  el("circle", { cx: x, cy: y, r: 3, fill: "#b3261e", stroke: "#fff" }, g);
}

// Two views at one scale that holds every posture of `all`, so that the picture does not jump.
function armViews(arm, all) {
  const box = [Infinity, -Infinity, Infinity, -Infinity, Infinity, -Infinity, Infinity, -Infinity];
  const grow = (k, v) => { box[k] = Math.min(box[k], v); box[k + 1] = Math.max(box[k + 1], v); };
  for (const points of all) {
    const h = sideDirection(arm, points);
    for (const p of points) {
      const d = sub(p, arm.base);
      grow(0, dot(d, h)); grow(2, dot(d, arm.up)); grow(4, p[0]); grow(6, p[1]);
    }
  }
  const W = 340, pad = 16, head = 18, spanX = Math.max(box[1] - box[0], box[5] - box[4], 1);
  const edgewise = box[7] - box[6] < 0.1 * spanX; // an arm that stays in one upright plane is a line from above
  const scale = Math.min((W - 2 * pad) / spanX, 250 / Math.max(box[3] - box[2], 1), 210 / Math.max(box[7] - box[6], 1));
  const h1 = (box[3] - box[2]) * scale + 2 * pad, h2 = (box[7] - box[6]) * scale + 2 * pad;
  return function draw(postures, outline) {
    const line = edgewise || outline && [0, 1].some(i => outline.every(p => Math.abs(p[i] - outline[0][i]) < 1)), above = !line;
    const svg = el("svg", { viewBox: `0 0 ${W} ${h1 + head + (above ? h2 + head : 0)}`, class: "plot" });
    const left1 = (W - (box[1] - box[0]) * scale) / 2, left2 = (W - (box[5] - box[4]) * scale) / 2, top2 = h1 + head;
    el("text", { x: 4, y: 13, class: "tick" }, svg, "side view");
    const floor = head + h1 - pad + box[2] * scale;
    el("line", { x1: 4, x2: W - 4, y1: floor, y2: floor, stroke: "#aab2bc", "stroke-dasharray": "4 3" }, svg);
    const top = p => [left2 + (p[0] - box[4]) * scale, top2 + head + h2 - pad - (p[1] - box[6]) * scale];
    if (outline && above) el("path", { d: outline.map(top).map(([x, y], i) => (i ? "L" : "M") + x.toFixed(1) + " " + y.toFixed(1)).join("") + "Z", fill: "none", stroke: "#1552b8", "stroke-dasharray": "5 3", opacity: 0.6 }, svg);
    if (above) el("text", { x: 4, y: top2 + 13, class: "tick onlines" }, svg, "from above");
    for (const { points, color, opacity } of postures) {
      const h = sideDirection(arm, points);
      drawArm(svg, points.map(p => { const d = sub(p, arm.base); return [left1 + (dot(d, h) - box[0]) * scale, head + h1 - pad - (dot(d, arm.up) - box[2]) * scale]; }), color, opacity, 7);
      if (above) drawArm(svg, points.map(top), color, opacity, 7);
    }
    return svg;
  };
}
