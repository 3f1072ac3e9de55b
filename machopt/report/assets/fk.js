// Forward kinematics of a tree of joints, and what springs in them do at the tool. A motion is twelve numbers: three rows of a
// rotation and a place. Joint i turns (or slides) what it carries about its line at zero: M_i = M_parent · exp(line_i θ_i), θ = C q.
const FK = (() => {
  const STILL = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const turn = (M, v) => [0, 4, 8].map(i => M[i] * v[0] + M[i + 1] * v[1] + M[i + 2] * v[2]);
  const place = (M, p) => { const v = turn(M, p); return [v[0] + M[3], v[1] + M[7], v[2] + M[11]]; };
  const origin = M => [M[3], M[7], M[11]];

  function after(A, B) {
    const out = new Array(12);
    for (let r = 0; r < 12; r += 4) {
      for (let c = 0; c < 4; c++) out[r + c] = A[r] * B[c] + A[r + 1] * B[4 + c] + A[r + 2] * B[8 + c];
      out[r + 3] += A[r + 3];
    }
    return out;
  }

  function inverse(M) {
    const R = [M[0], M[4], M[8], M[1], M[5], M[9], M[2], M[6], M[10]], p = origin(M);
    const at = [0, 3, 6].map(i => -(R[i] * p[0] + R[i + 1] * p[1] + R[i + 2] * p[2]));
    return [R[0], R[1], R[2], at[0], R[3], R[4], R[5], at[1], R[6], R[7], R[8], at[2]];
  }

  // Rodrigues' formula about a line; what it leaves of the line's point is its place.
  function screw(joint, value) {
    const h = joint.axis, x = joint.point;
    if (joint.prismatic) return [1, 0, 0, h[0] * value, 0, 1, 0, h[1] * value, 0, 0, 1, h[2] * value];
    const c = Math.cos(value), s = Math.sin(value), v = 1 - c;
    const R = [
      c + v * h[0] * h[0], v * h[0] * h[1] - s * h[2], v * h[0] * h[2] + s * h[1], 0,
      v * h[1] * h[0] + s * h[2], c + v * h[1] * h[1], v * h[1] * h[2] - s * h[0], 0,
      v * h[2] * h[0] - s * h[1], v * h[2] * h[1] + s * h[0], c + v * h[2] * h[2], 0,
    ], Rx = turn(R, x);
    R[3] = x[0] - Rx[0]; R[7] = x[1] - Rx[1]; R[11] = x[2] - Rx[2];
    return R;
  }

  // C q: lines of the arm that turn with more than one joint; joints beyond the arm go by themselves.
  const turned = (scene, q) => scene.coupling ? q.map((v, i) => i < scene.coupling.length ? scene.coupling[i].reduce((sum, c, j) => sum + c * q[j], 0) : v) : q;

  // What each joint makes of the bodies it carries, in root axes. Parents may stand behind their children in the list.
  function motions(scene, q) {
    const by = turned(scene, q), out = [];
    const of = i => { if (!out[i]) { const j = scene.joints[i], own = screw(j, by[i]); out[i] = j.parent < 0 ? own : after(of(j.parent), own); } return out[i]; };
    scene.joints.forEach((_, i) => of(i));
    return out;
  }

  const tool = (scene, M) => after(scene.tool_joint < 0 ? STILL : M[scene.tool_joint], scene.tool);
  const part = (scene, M) => after(scene.part_joint < 0 ? STILL : M[scene.part_joint], scene.part);

  // By how many metres the tip goes with a radian (or metre) of each joint, in root axes; joints that do not carry the tool: 0.
  function levers(scene, M, tip) {
    const own = scene.joints.map(() => [0, 0, 0]);
    for (let i = scene.tool_joint; i >= 0; i = scene.joints[i].parent) {
      const j = scene.joints[i], h = turn(M[i], j.axis), x = place(M[i], j.point);
      own[i] = j.prismatic ? h : cross(h, [tip[0] - x[0], tip[1] - x[1], tip[2] - x[2]]);
    }
    if (!scene.coupling) return own;
    const n = scene.coupling.length;
    return own.map((lever, q) => q >= n ? lever : [0, 1, 2].map(c => own.slice(0, n).reduce((sum, l, i) => sum + l[c] * scene.coupling[i][q], 0)));
  }

  // C = Σ l lᵀ / k in m/N, row by row; k in N·m/rad by joint, joints without one hold.
  function compliance(scene, M, k) {
    const C = new Array(9).fill(0);
    levers(scene, M, origin(tool(scene, M))).forEach((l, j) => {
      if (k[j]) for (let r = 0; r < 3; r++) for (let c = 0; c < 3; c++) C[3 * r + c] += l[r] * l[c] / k[j];
    });
    return C;
  }

  // Eigenvalues of a symmetric 3 × 3 matrix, largest first (Smith 1961: the roots of its cubic by an angle).
  function eigenvalues(C) {
    const mean = (C[0] + C[4] + C[8]) / 3, off = C[1] ** 2 + C[2] ** 2 + C[5] ** 2;
    const p = Math.sqrt(((C[0] - mean) ** 2 + (C[4] - mean) ** 2 + (C[8] - mean) ** 2 + 2 * off) / 6);
    if (!p) return [mean, mean, mean];
    const [a, b, c, d, e, f] = [C[0] - mean, C[4] - mean, C[8] - mean, C[1], C[2], C[5]].map(v => v / p);
    const half = (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / 2;
    const angle = Math.acos(Math.min(1, Math.max(-1, half))) / 3;
    const first = mean + 2 * p * Math.cos(angle), last = mean + 2 * p * Math.cos(angle + 2 * Math.PI / 3);
    return [first, 3 * mean - first - last, last];
  }

  // A vector or a symmetric matrix of base_link, in root axes.
  const baseOf = (scene, M) => scene.base_joint < 0 ? STILL : M[scene.base_joint];
  function spread(B, C) {
    const R = [0, 4, 8].map(i => B.slice(i, i + 3)), RC = R.map(r => [0, 1, 2].map(c => r[0] * C[c] + r[1] * C[3 + c] + r[2] * C[6 + c]));
    return RC.flatMap(r => R.map(row => dot(r, row)));
  }

  const times = (C, f) => [0, 3, 6].map(i => C[i] * f[0] + C[i + 1] * f[1] + C[i + 2] * f[2]);
  return { baseOf, spread, STILL, after, inverse, screw, motions, tool, part, levers, compliance, eigenvalues, times, place, turn, origin, dot };
})();
