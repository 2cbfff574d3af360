// The Khronos validator on the GLB files named on the command line: one JSON line each, {file, errors, ...}.
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { resolve } from "node:path";

const require = createRequire(resolve(process.env.REFEREE, "package.json"));
const { validateBytes } = require("gltf-validator");

for (const file of process.argv.slice(2)) {
  const report = await validateBytes(new Uint8Array(readFileSync(file)), { maxIssues: 1000 });
  const { numErrors, numWarnings, numInfos, numHints, messages } = report.issues;
  const seen = [...new Set(messages.map((m) => `${m.code} ${m.message} ${m.pointer ?? ""}`))].slice(0, 20);
  const row = { file, errors: numErrors, warnings: numWarnings, infos: numInfos, hints: numHints, messages: seen };
  console.log(JSON.stringify(row));
}
