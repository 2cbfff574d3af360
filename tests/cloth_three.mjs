// Where three.js puts the points of a mesh of a GLB that it plays: argv[2] the file, argv[3] the name of the mesh's node,
// argv[4] times as JSON. Prints [[x, y, z, ...] of each time], in the world.
import { readFileSync } from "node:fs";
import { resolve } from "node:path";
import { pathToFileURL } from "node:url";

globalThis.self = globalThis;
globalThis.createImageBitmap = async () => ({ width: 1, height: 1, close() {} });
const from = resolve(process.env.REFEREE, "node_modules", "three");
const THREE = await import(pathToFileURL(resolve(from, "build/three.module.js")));
const { GLTFLoader } = await import(pathToFileURL(resolve(from, "examples/jsm/loaders/GLTFLoader.js")));

const [, , file, name, times] = process.argv;
const bytes = readFileSync(file);
const gltf = await new GLTFLoader().parseAsync(bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.length), "");
const mesh = gltf.scene.getObjectByName(name);
const mixer = new THREE.AnimationMixer(gltf.scene);
for (const clip of gltf.animations) mixer.clipAction(clip).play();
const out = [], point = new THREE.Vector3();
for (const time of JSON.parse(times)) {
  mixer.setTime(time);
  gltf.scene.updateMatrixWorld(true);
  mesh.skeleton.update();
  const row = [];
  for (let i = 0; i < mesh.geometry.attributes.position.count; i++) {
    row.push(...mesh.getVertexPosition(i, point).applyMatrix4(mesh.matrixWorld).toArray());
  }
  out.push(row);
}
console.log(JSON.stringify(out));
