// Levels of articulation at run time. No drawing library here.
// A joint above the level follows its nearest ancestor that is kept, with that ancestor's matrix, as if its weights and
// what hangs on it were the ancestor's: ISO/IEC 19774-1, levels of articulation.

export const LEVELS = [0, 1, 2, 3, 4];

/** For each joint the joint whose matrix it takes at level `n`: itself, or its nearest kept ancestor. Roots are kept. */
export function keptAt(loa, parents, n) {
  const kept = new Uint16Array(parents.length);
  parents.forEach((p, j) => { kept[j] = p < 0 || (loa[j] ?? 0) <= n ? j : kept[p]; });
  return kept;
}

/** Number of joints at each level. */
export const counts = (loa, parents) => LEVELS.map((n) => keptAt(loa, parents, n).reduce((sum, k, j) => sum + (k === j), 0));

/** Parent of each kept joint among the kept ones, -1 for roots; of the others the joint that they follow. */
export const aboveAt = (kept, parents) => parents.map((p, j) => (kept[j] !== j ? kept[j] : p < 0 ? -1 : kept[p]));

/** Rows of 12 of `pose` into `out`, each joint with those of the joint it follows. */
export function follow(pose, kept, out) {
  for (let j = 0; j < kept.length; j++) {
    const from = 12 * kept[j], to = 12 * j;
    for (let i = 0; i < 12; i++) out[to + i] = pose[from + i];
  }
  return out;
}

/** Joint that the camera follows: the first that has several children, else the first. */
export function root(figure) {
  if (figure.rootJoint === undefined) {
    const children = figure.joints.map((_, j) => figure.parents.filter((p) => p === j).length);
    figure.rootJoint = Math.max(0, children.findIndex((n) => n > 1));
  }
  return figure.rootJoint;
}

/** Joint with the most skin: a good first one to show the weights of. */
export function heaviest(figure) {
  const sum = new Float64Array(figure.joints.length);
  figure.joint.forEach((j, k) => { sum[figure.kept[j]] += figure.weight[k]; });
  return sum.indexOf(Math.max(...sum));
}
