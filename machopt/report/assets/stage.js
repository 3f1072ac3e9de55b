// The 3-D picture itself: cell, arms, toolpath, markers. It draws when something has changed, and never by itself.
function unpack(text, Kind) { return new Kind(bytes(text).buffer); }

// Joint values that were stored as levels: row by row, null where there is no posture.
function levelled(spec) {
  const data = unpack(spec.data, Uint16Array), n = spec.low.length;
  return {
    rows: data.length / n,
    row(k) {
      const out = new Array(n);
      for (let j = 0; j < n; j++) {
        const level = data[k * n + j];
        if (level === 65535) return null;
        out[j] = spec.low[j] + level * spec.step[j];
      }
      return out;
    },
  };
}

const BODY_COLORS = { link: "#e2803a", tool: "#7d8793", cutter: "#c8ced6", workpiece: "#6f9bd1", stock: "#d9b95b", obstacle: "#9aa3ad" };

function stage3d(canvas, scene) {
  const context = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true, alpha: true });
  if (!context) return null;
  const renderer = new THREE.WebGLRenderer({ canvas, context, antialias: true, alpha: true });
  const world = new THREE.Scene(), root = new THREE.Group(), camera = new THREE.PerspectiveCamera(38, 1, 0.02, 100);
  const onPart = new THREE.Group(); // what is given in the frame of the toolpath
  const matrix = M => new THREE.Matrix4().set(...M.slice(0, 12), 0, 0, 0, 1);
  const moved = (object, M) => { object.matrixAutoUpdate = false; object.matrix.copy(matrix(M)); object.matrixWorldNeedsUpdate = true; return object; };
  moved(root, scene.root);
  world.add(root);
  root.add(onPart);
  world.add(new THREE.HemisphereLight("#ffffff", "#9aa0aa", 2.4));
  const lamp = new THREE.DirectionalLight("#ffffff", 1.5);
  camera.add(lamp);
  lamp.position.set(0.6, 0.8, 1);
  world.add(camera);
  camera.up.set(0, 0, 1);

  const shapes = scene.bodies.map(b => {
    const at = unpack(b.at, Uint16Array), place = new Float32Array(at.length);
    for (let i = 0; i < at.length; i++) place[i] = b.low[i % 3] + at[i] * b.step[i % 3];
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(place, 3));
    geometry.setIndex(new THREE.BufferAttribute(unpack(b.faces, b.wide ? Uint32Array : Uint16Array), 1));
    geometry.computeBoundingBox();
    return { ...b, geometry };
  });
  const skin = (kind, opacity, color) => new THREE.MeshLambertMaterial({
    color: color || BODY_COLORS[kind], flatShading: true, side: 2, transparent: opacity < 1, opacity, depthWrite: opacity === 1, polygonOffset: true, polygonOffsetFactor: 1,
  });

  const meshes = []; // [mesh, kind] of everything that is looked at for collisions
  // A robot without bodies is drawn as lines from joint to joint: pairs of places, the tip last.
  const bare = !shapes.some(s => s.kind === "link" && s.joint >= 0);
  function skeleton(M) {
    const way = [FK.origin(FK.tool(scene, M))];
    for (let i = scene.tool_joint; i >= 0; i = scene.joints[i].parent) way.unshift(FK.place(M[i], scene.joints[i].point));
    return way.slice(1).flatMap((p, i) => [way[i], p]);
  }

  // One robot: all bodies that some joint carries. Several may stand in one picture.
  function arm({ opacity = 1, color = "", leads = opacity === 1 } = {}) {
    const group = new THREE.Group(), held = [];
    for (const s of shapes) if (s.joint >= 0) { const mesh = new THREE.Mesh(s.geometry, skin(s.kind, s.kind === "stock" ? 0.25 * opacity : opacity, color)); held.push([mesh, s.joint, s.tools]); meshes.push([mesh, s.kind]); group.add(mesh); }
    root.add(group);
    let bones = null;
    const hold = n => { for (const [mesh, , tools] of held) mesh.visible = !tools.length || tools.includes(n); };
    hold(0);
    return {
      group,
      hold, // which of the scene's tools is on
      stand(q) {
        group.visible = Boolean(q);
        if (!q) return;
        const M = FK.motions(scene, q);
        for (const [mesh, joint] of held) moved(mesh, M[joint]);
        if (leads) moved(onPart, FK.part(scene, M));
        if (!bare || opacity < 1) return;
        if (bones) bones.removeFromParent();
        bones = lines(skeleton(M).flat(), null, 4, group);
      },
    };
  }
  // with raw stock the finished part is opaque: a transparent body writes no depth, and its far faces show through
  const solid = shapes.some(s => s.kind === "stock") ? 1 : 0.75;
  for (const s of shapes) if (s.joint < 0) { const mesh = new THREE.Mesh(s.geometry, skin(s.kind, s.kind === "stock" ? 0.25 : s.kind === "workpiece" ? solid : 1)); meshes.push([mesh, s.kind]); root.add(moved(mesh, FK.STILL)); }
  const kinds = () => [...new Set(meshes.map(([, kind]) => kind))];
  function showKind(kind, on) { for (const [mesh, own] of meshes) if (own === kind) mesh.material.visible = on; draw(); } // whether a mesh is there at all is the tool's matter

  // Lines of a width in pixels; colours as triples 0…1, one a point.
  function lines(points, colors, width, parent = onPart) {
    const geometry = new THREE.LineSegmentsGeometry();
    geometry.setPositions(points);
    if (colors) geometry.setColors(colors);
    const line = new THREE.LineSegments2(geometry, new THREE.LineMaterial({ linewidth: width, vertexColors: Boolean(colors), color: colors ? "#ffffff" : "#7a8490" }));
    parent.add(line);
    return line;
  }

  const ball = new THREE.SphereGeometry(1, 24, 16), shaft = new THREE.CylinderGeometry(1, 1, 1, 12), tip = new THREE.CylinderGeometry(0, 1, 1, 16);
  const glow = (color, opacity = 1) => new THREE.MeshBasicMaterial({ color, transparent: opacity < 1, opacity, depthTest: opacity === 1 });
  function marker(radius, color, opacity = 1) {
    const mesh = new THREE.Mesh(ball, glow(color, opacity));
    root.add(mesh);
    mesh.visible = false;
    return { at(p) { mesh.visible = Boolean(p); if (p) moved(mesh, [radius, 0, 0, p[0], 0, radius, 0, p[1], 0, 0, radius, p[2]]); } };
  }

  // The unit ball mapped by a symmetric matrix: where the tip goes under a unit force from all sides.
  function ellipsoid(color) {
    const mesh = new THREE.Mesh(ball, new THREE.MeshLambertMaterial({ color, transparent: true, opacity: 0.45, depthWrite: false }));
    root.add(mesh);
    mesh.visible = false;
    return { at(p, C, scale) { mesh.visible = Boolean(p && C); if (mesh.visible) moved(mesh, [0, 3, 6].flatMap((r, i) => [C[r] * scale, C[r + 1] * scale, C[r + 2] * scale, p[i]])); } };
  }

  function arrow(color) {
    const group = new THREE.Group(), body = new THREE.Mesh(shaft, glow(color)), head = new THREE.Mesh(tip, glow(color));
    group.add(body, head);
    root.add(group);
    group.visible = false;
    return {
      at(p, v, radius) {
        const length = v ? Math.hypot(...v) : 0;
        group.visible = Boolean(p) && length > 0;
        if (!group.visible) return;
        const y = v.map(c => c / length), side = Math.abs(y[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0];
        const x = [y[1] * side[2] - y[2] * side[1], y[2] * side[0] - y[0] * side[2], y[0] * side[1] - y[1] * side[0]], n = Math.hypot(...x);
        const a = x.map(c => c / n), b = [a[1] * y[2] - a[2] * y[1], a[2] * y[0] - a[0] * y[2], a[0] * y[1] - a[1] * y[0]];
        const cut = Math.min(length * 0.4, 6 * radius), long = length - cut;
        const put = (mesh, from, size, r) => moved(mesh, [0, 1, 2].flatMap(i => [a[i] * r, y[i] * size, b[i] * r, p[i] + y[i] * (from + size / 2)]));
        put(body, 0, Math.max(long, 1e-6), radius);
        put(head, long, cut, 2.4 * radius);
      },
    };
  }

  // The box of what moves, and of what is pointed out by more points of the root.
  const low = [Infinity, Infinity, Infinity], high = [-Infinity, -Infinity, -Infinity];
  const grow = p => { const w = FK.place(scene.root, p); for (let i = 0; i < 3; i++) { low[i] = Math.min(low[i], w[i]); high[i] = Math.max(high[i], w[i]); } };
  function include(q) {
    const M = FK.motions(scene, q);
    moved(onPart, FK.part(scene, M));
    if (bare) skeleton(M).forEach(grow); // else there is no box, and nothing to measure arrows by
    for (const s of shapes) if (s.joint >= 0 || s.kind === "workpiece" || s.kind === "stock") {
      const { min, max } = s.geometry.boundingBox;
      for (let i = 0; i < 8; i++) { const p = [i & 1 ? max.x : min.x, i & 2 ? max.y : min.y, i & 4 ? max.z : min.z]; grow(s.joint < 0 ? p : FK.place(M[s.joint], p)); }
    }
  }

  const controls = new THREE.OrbitControls(camera, canvas);
  controls.enableDamping = false;
  controls.enableZoom = false; // the wheel belongs to the page until the picture is asked for
  canvas.addEventListener("focus", () => { controls.enableZoom = true; });
  canvas.addEventListener("blur", () => { controls.enableZoom = false; });
  canvas.addEventListener("pointerdown", () => canvas.focus({ preventScroll: true }));
  let due = 0;
  const after = []; // what lies over the picture and follows it
  const paintNow = () => { due = 0; renderer.render(world, camera); for (const act of after) act(); };
  const draw = () => { if (!due) due = requestAnimationFrame(paintNow); };
  controls.addEventListener("change", draw);

  function resize() {
    const w = canvas.clientWidth, h = canvas.clientHeight;
    if (!w || !h) return;
    renderer.setPixelRatio(Math.min(window.devicePixelRatio || 1, 2));
    renderer.setSize(w, h, false);
    camera.aspect = w / h;
    camera.updateProjectionMatrix();
    draw();
  }

  const WAYS = { corner: [0.75, -1, 0.55], front: [1, 0, 0.05], side: [0, -1, 0.05], top: [0.001, 0, 1] };
  function look(name, about = null, far = null) {
    const middle = about || low.map((v, i) => (v + high[i]) / 2), size = far || Math.hypot(...low.map((v, i) => high[i] - v)) || 1;
    const way = WAYS[name] || WAYS.corner, n = Math.hypot(...way);
    let distance = size * 0.47 / Math.tan(camera.fov * Math.PI / 360) / Math.min(1, camera.aspect * 1.15);
    if (!about) distance = Math.max(distance, holding(way.map(c => c / n), middle, 0.35 * size));
    controls.target.set(...middle);
    camera.position.set(...middle.map((v, i) => v + way[i] / n * distance));
    camera.near = distance / 200; camera.far = distance * 20;
    camera.updateProjectionMatrix();
    controls.update();
    draw();
  }

  // How far away all standing bodies are whole in the picture that reach no farther than `room` beyond the box: a table's legs, not a hall's floor.
  function holding(u, middle, room) {
    const f = Math.hypot(u[0], u[1]), right = [-u[1] / f, u[0] / f, 0], up = [-u[2] * right[1], u[2] * right[0], f], t = Math.tan(camera.fov * Math.PI / 360) * 0.96;
    const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let far = 0;
    for (const s of shapes) if (s.joint < 0) {
      const { min, max } = s.geometry.boundingBox, w = [];
      for (let i = 0; i < 8; i++) w.push(FK.place(scene.root, [i & 1 ? max.x : min.x, i & 2 ? max.y : min.y, i & 4 ? max.z : min.z]));
      if (w.some(p => p.some((c, i) => c < low[i] - room || c > high[i] + room))) continue;
      for (const p of w) { const d = p.map((c, i) => c - middle[i]); far = Math.max(far, dot(d, u) + Math.max(Math.abs(dot(d, up)) / t, Math.abs(dot(d, right)) / t / camera.aspect)); }
    }
    return far;
  }

  function zoom(factor) {
    camera.position.sub(controls.target).multiplyScalar(factor).add(controls.target);
    controls.update();
    draw();
  }

  // Where a point of the root is on the canvas, in its pixels; null behind the camera.
  function onCanvas(p) {
    const v = new THREE.Vector3(...FK.place(scene.root, p)).project(camera);
    return v.z > 1 ? null : [(v.x + 1) / 2 * canvas.clientWidth, (1 - v.y) / 2 * canvas.clientHeight];
  }

  new ResizeObserver(resize).observe(canvas);
  return { after, kinds, showKind, arm, lines, marker, ellipsoid, arrow, include, grow, look, zoom, draw, paintNow, resize, onCanvas, renderer, world, camera, root, size: () => Math.hypot(...low.map((v, i) => high[i] - v)) };
}

// Which bodies are drawn, kind by kind.
function bodySwitches(stage, host) {
  if (stage.kinds().length < 2) return;
  const words = stage.kinds().includes("stock") ? { stock: "raw stock", workpiece: "finished part" } : {};
  const box = document.createElement("fieldset"), title = document.createElement("legend");
  box.className = "bodies";
  title.textContent = "Bodies";
  box.append(title);
  for (const kind of stage.kinds()) {
    const label = document.createElement("label"), input = document.createElement("input");
    input.type = "checkbox"; input.checked = true;
    input.onchange = () => stage.showKind(kind, input.checked);
    label.append(input, words[kind] || kind);
    box.append(label);
  }
  host.append(box);
}

// The toolpath in the picture: cuts coloured by their value, the rest thin and grey.
function pathLines(stage, path) {
  const at = unpack(path.at, Float32Array), value = unpack(path.value, Float32Array), cutting = bytes(path.cutting), cut = [], colors = [], air = [];
  const good = v => { const t = (v - path.from) / (path.to - path.from || 1); return path.large_is_good ? t : 1 - t; };
  const linear = c => { const v = c / 255; return v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4; }; // the renderer's own measure
  for (let k = 1; k < value.length; k++) {
    const ends = at.subarray(3 * k - 3, 3 * k + 3);
    if (cutting[k >> 3] >> (k & 7) & 1) {
      const color = !path.known ? [0.2, 0.45, 0.85] : Number.isFinite(value[k]) ? ramp(good(value[k])).map(linear) : [0.85, 0.2, 0.2];
      cut.push(...ends); colors.push(...color, ...color);
    } else air.push(...ends);
  }
  if (air.length) stage.lines(air, null, 1);
  if (cut.length) stage.lines(cut, colors, path.known ? 3.5 : 2);
  if (path.outcome) outcomeDots(stage, path, at, linear);
}

// Points with a tolerance as dots in the colour of their outcome; where there are many, those in tolerance are thinned.
const OUTCOME_COLORS = { pass: [42, 143, 76], marginal: [217, 164, 0], fail: [200, 30, 30], unknown: [122, 132, 144] };
function outcomeDots(stage, path, at, linear) {
  const outcome = bytes(path.outcome), dots = [], colors = [];
  let all = 0;
  for (const code of outcome) all += code > 0;
  const every = Math.max(1, Math.ceil(all / 1500));
  let n = 0;
  for (let k = 0; k < outcome.length; k++) {
    const word = outcome[k] && path.outcomes[outcome[k] - 1];
    if (!word || (word === "pass" && n++ % every)) continue;
    const p = at.subarray(3 * k, 3 * k + 3), color = OUTCOME_COLORS[word].map(linear);
    dots.push(...p, p[0], p[1], p[2] + 1e-5); // a line this short is drawn as a round dot
    colors.push(...color, ...color);
  }
  if (dots.length) stage.lines(dots, colors, 9);
}
