// three.js makes a skinned, animated, morphed figure, exports it as GLB to argv[2], and prints where its own player puts
// the vertices at some times: {"times": [...], "vertices": [[x, y, z, ...], ...], "bones": {name: [x, y, z]}}.
import { writeFileSync } from "node:fs";
import { resolve } from "node:path";
import { pathToFileURL } from "node:url";

globalThis.FileReader = class {
  readAsArrayBuffer(blob) {
    blob.arrayBuffer().then((data) => { this.result = data; this.onloadend(); });
  }
};
const from = resolve(process.env.REFEREE, "node_modules", "three");
const THREE = await import(pathToFileURL(resolve(from, "build/three.module.js")));
const { GLTFExporter } = await import(pathToFileURL(resolve(from, "examples/jsm/exporters/GLTFExporter.js")));

// [bone, parent, place]; every bone also gets a frame of its own
const PLAN = [
  ["Hips", "", [0, 0.95, 0]], ["Spine", "Hips", [0, 1.1, 0]], ["Spine1", "Spine", [0, 1.25, 0]],
  ["Neck", "Spine1", [0, 1.5, 0]], ["Head", "Neck", [0, 1.6, 0]],
];
for (const [side, x] of [["Left", 1], ["Right", -1]]) {
  PLAN.push([`${side}Arm`, "Spine1", [0.18 * x, 1.42, 0]], [`${side}ForeArm`, `${side}Arm`, [0.45 * x, 1.42, 0]]);
  PLAN.push([`${side}Hand`, `${side}ForeArm`, [0.7 * x, 1.42, 0]], [`${side}UpLeg`, "Hips", [0.1 * x, 0.9, 0]]);
  PLAN.push([`${side}Leg`, `${side}UpLeg`, [0.1 * x, 0.5, 0]], [`${side}Foot`, `${side}Leg`, [0.1 * x, 0.08, 0]]);
}
const bones = new Map();
const group = new THREE.Group();
group.name = "figure";
PLAN.forEach(([name, parent, place], k) => {
  const bone = new THREE.Bone();
  bone.name = name;
  const above = parent ? bones.get(parent) : group;
  group.updateMatrixWorld(true);
  const world = new THREE.Matrix4().compose(
    new THREE.Vector3(...place), new THREE.Quaternion().setFromEuler(new THREE.Euler(k, 2 * k, 0.3 * k)),
    new THREE.Vector3(1, 1, 1));
  above.add(bone);
  new THREE.Matrix4().copy(above.matrixWorld).invert().multiply(world)
    .decompose(bone.position, bone.quaternion, bone.scale);
  bones.set(name, bone);
});
group.updateMatrixWorld(true);
const list = [...bones.values()];

const geometry = new THREE.BufferGeometry();
const position = [], index = [], joint = [], weight = [], move = [];
PLAN.forEach(([name, parent, place], k) => {
  const start = position.length / 3, up = parent ? PLAN.findIndex((p) => p[0] === parent) : k;
  for (const [x, y, z] of [[0, 0, 0.05], [0.05, 0, -0.02], [-0.05, 0, -0.02], [0, 0.07, 0]]) {
    position.push(place[0] + x, place[1] + y, place[2] + z);
    joint.push(k, up, 0, 0);
    weight.push(0.6, 0.4, 0, 0);
    move.push(0, name === "Head" ? 0.02 : 0, name === "Head" ? 0.01 : 0);
  }
  for (const [a, b, c] of [[0, 1, 3], [1, 2, 3], [2, 0, 3], [0, 2, 1]]) index.push(start + a, start + b, start + c);
});
geometry.setAttribute("position", new THREE.Float32BufferAttribute(position, 3));
geometry.setAttribute("skinIndex", new THREE.Uint16BufferAttribute(joint, 4));
geometry.setAttribute("skinWeight", new THREE.Float32BufferAttribute(weight, 4));
geometry.setIndex(index);
geometry.morphAttributes.position = [new THREE.Float32BufferAttribute(move, 3)];
geometry.morphAttributes.position[0].name = "surprise";
geometry.morphTargetsRelative = true;
geometry.computeVertexNormals();
const mesh = new THREE.SkinnedMesh(geometry, new THREE.MeshStandardMaterial({ color: 0x3366cc, name: "cloth" }));
mesh.name = "tetrahedra";
group.add(mesh);
mesh.bind(new THREE.Skeleton(list));

const times = [0, 0.2, 0.4, 0.6], tracks = [];
for (const [k, name] of [[6, "LeftArm"], [2, "Spine1"], [9, "RightUpLeg"]]) {
  const q = bones.get(name).quaternion, values = [];
  times.forEach((t, i) => {
    const turn = new THREE.Quaternion().setFromEuler(new THREE.Euler(0.3 * i, 0.2 * i * k / 6, -0.1 * i));
    values.push(...q.clone().multiply(turn).toArray());
  });
  tracks.push(new THREE.QuaternionKeyframeTrack(`${name}.quaternion`, times, values));
}
const hips = bones.get("Hips").position;
tracks.push(new THREE.VectorKeyframeTrack(
  "Hips.position", times, times.flatMap((t) => [hips.x + t, hips.y - 0.1 * t, hips.z + 2 * t * t])));
tracks.push(new THREE.NumberKeyframeTrack("tetrahedra.morphTargetInfluences[surprise]", times, [0, 1, 0.5, 0]));
const clip = new THREE.AnimationClip("dance", 0.6, tracks);
const scene = new THREE.Scene();
scene.add(group);
const glb = await new GLTFExporter().parseAsync(scene, { binary: true, animations: [clip] });
writeFileSync(process.argv[2], Buffer.from(glb));

const mixer = new THREE.AnimationMixer(scene);
const action = mixer.clipAction(clip);
action.setLoop(THREE.LoopOnce);
action.clampWhenFinished = true;
action.play();
const vertices = times.map((t) => {
  mixer.setTime(t);
  scene.updateMatrixWorld(true);
  const out = [], v = new THREE.Vector3();
  for (let i = 0; i < geometry.attributes.position.count; i++) {
    mesh.getVertexPosition(i, v);
    out.push(...v.applyMatrix4(mesh.matrixWorld).toArray());
  }
  return out;
});
console.log(JSON.stringify({ times, vertices, bones: Object.fromEntries(PLAN.map(([n, , p]) => [n, p])) }));
