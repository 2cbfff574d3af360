// The skin of a figure, ready for the operators, out of a mesh message. No drawing library here.

import { bind, subset as part } from "./deform.js";
import { contourProgram, contoursOf } from "./contours.js";
import { handProgram, handsOf } from "./hands.js";

/** The skin of an actor's mesh message, with whatever its operators need. */
export function skinOf(header, blocks) {
  const get = (name) => blocks[name]?.array, rest = get("rest");
  const source = get("source"), triangles = source ? get("triangles").map((i) => source[i]) : get("triangles");
  const skin = bind({ rest, row: get("row"), joint: get("joint"), weight: get("weight"), triangles, centers: get("centers"), morphs: morphs(header.displacers, blocks) });
  return Object.assign(skin, { triangles, parents: header.parents, contours: contourProgram(get), hands: handProgram(get), made: {} });
}

/** The same skin with only those `vertices`, in that order: each deforms exactly as before. */
export function subset(skin, vertices) {
  const of = new Int32Array(skin.V).fill(-1);
  vertices.forEach((v, i) => { of[v] = i; });
  return Object.assign(part(skin, vertices), {
    contours: skin.contours && contoursOf(skin.contours, vertices), hands: skin.hands && handsOf(skin.hands, of), made: {}, whole: skin, vertices,
  });
}

function morphs(displacers, blocks) {
  const row = blocks.morph_row?.array, index = blocks.morph_index?.array, offset = blocks.morph_offset?.array;
  return displacers.map((d, i) => ({
    ...d, index: index.subarray(row[i], row[i + 1]), offset: offset.subarray(3 * row[i], 3 * row[i + 1]),
  }));
}
