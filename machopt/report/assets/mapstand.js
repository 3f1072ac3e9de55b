// The robot of the 3-D picture at the place of a map that is under the pointer, kept, or best.
function standAt(shown3d, view, spec) {
  const layers = spec.layers.map(l => ({ ...l, code: bytes(l.status), angle: new Int16Array(bytes(l.q).buffer) }));
  const posture = (l, k) => l.angle[6 * k] === -32768 ? null : [...Array.from({ length: 6 }, (_, j) => l.angle[6 * k + j] * spec.angle * Math.PI / 180), ...view.rest];
  const base = FK.baseOf(view.scene, FK.motions(view.scene, [0, 0, 0, 0, 0, 0, ...view.rest]));
  const inRoot = p => FK.place(base, FK.place(view.frame, p.map(v => v / 1000)));
  return (k, at, layer, outline) => {
    const own = layers[layer], other = layers.find(l => l !== own), q = posture(own, k);
    const name = spec.axes.map((a, i) => `${a.name} ${+at[i].toFixed(1)}`).join(", ").replaceAll("-", "−") + ` ${spec.axes[0].unit}`;
    const words = layers.length > 1 ? [["Shown", own.title]] : [];
    if (!q) words.push(["State", spec.names[own.code[k]]]);
    else if (other && posture(other, k)) words.push(["Shadow", other.title]);
    shown3d.stand(q, name, words, other ? posture(other, k) : null, outline && outline.map(inRoot));
  };
}
