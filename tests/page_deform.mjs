// Runs the page's deformers and its gauge outside of a browser: node page_deform.mjs PAGE JOBS.json
// Jobs: [{mesh, pose, weights, names, some, measured, joints, tuned}], files of a mesh message and of (J,12) float32 poses. Points
// go to MESH.NAME (float32), those of the vertices `some` alone to MESH.NAME.some, answers to stdout.
import { readFileSync, writeFileSync } from "node:fs";
import { pathToFileURL } from "node:url";
import { join } from "node:path";

const [, , folder, file] = process.argv;
const load = (name) => import(pathToFileURL(join(folder, name)));
const [{ decode }, { skinOf }, { able, run }, { subset }, { Gauge }, { tune }] = await Promise.all(["wire.js", "skin.js", "operators.js", "skin.js", "gauge.js", "hands.js"].map(load));
const read = (path) => { const b = readFileSync(path); return b.buffer.slice(b.byteOffset, b.byteOffset + b.byteLength); };
const out = [];
for (const job of JSON.parse(readFileSync(file, "utf8"))) {
  const { header, blocks } = decode(read(job.mesh)), skin = skinOf(header, blocks[header.actor]);
  const pose = new Float32Array(read(job.pose)), gauge = job.joints ? new Gauge(skin) : null, answer = {};
  if (job.tuned) tune(skin.hands, job.tuned);
  for (const name of job.names) {
    if (!able(name, skin)) { answer[name] = null; continue; }
    const positions = new Float32Array(3 * skin.V), normals = new Float32Array(3 * skin.V);
    run(name, skin, pose, job.weights ?? [], positions, normals);
    writeFileSync(`${job.mesh}.${name}`, positions);
    answer[name] = {};
    if (job.some) {
      const part = subset(skin, job.some), p = new Float32Array(3 * part.V), n = new Float32Array(3 * part.V);
      run(name, part, pose, job.weights ?? [], p, n);
      writeFileSync(`${job.mesh}.${name}.some`, p);
    }
    if (gauge && job.measured.includes(name)) {
      const { whole, joints } = gauge.measure(positions, pose, job.joints);
      answer[name].quality = { whole, joints: Object.fromEntries([...joints].map(([j, q]) => [header.joints[j], q])) };
    }
  }
  out.push(answer);
}
process.stdout.write(JSON.stringify(out, (_, x) => (typeof x === "number" && !Number.isFinite(x) ? null : x)));
