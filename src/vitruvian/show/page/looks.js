// Materials: skin that is warm where light fades, glossy eyes, and flat ones for maps of data.

import * as THREE from "three";

const SKIN = /skin|body|head|face|hand|foot|feet|arm|leg|torso|lips|nails/i;
const EYE = /eye(?!brow|lash)|iris|pupil|sclera|cornea/i;
const HAIR = /hair|brow|lash|beard/i;

/** The material of one part {name, color, roughness, metallic, opacity, double_sided}; `painted`: vertices have colours. */
export function material(part, painted) {
  const glossy = EYE.test(part.name), hair = HAIR.test(part.name);
  const skin = !glossy && !hair && part.metallic < 0.5 && SKIN.test(part.name);
  const options = {
    color: painted ? new THREE.Color(1, 1, 1) : new THREE.Color().setRGB(...part.color, THREE.SRGBColorSpace),
    vertexColors: painted, metalness: part.metallic, roughness: Math.max(0.06, part.roughness),
    side: part.double_sided ? THREE.DoubleSide : THREE.FrontSide,
    transparent: part.opacity < 1, opacity: part.opacity, depthWrite: part.opacity > 0.6,
  };
  if (glossy) {
    const wet = { roughness: Math.min(options.roughness, 0.22), clearcoat: 1, clearcoatRoughness: 0.03, envMapIntensity: 1.1 };
    return lit(new THREE.MeshPhysicalMaterial({ ...options, ...wet }), [0.1, 0.1, 0.1], 0.5, true);
  }
  const made = new THREE.MeshStandardMaterial(options);
  if (!skin) return hair ? lit(made, [0.3, 0.22, 0.16], 0.7) : lit(made, [0.08, 0.08, 0.08]);
  made.roughness = Math.min(Math.max(options.roughness, 0.42), 0.62);
  return lit(made, [0.34, 0.13, 0.08]);
}

/**
 * Let light wrap around the edge of the lit side, more of it in the red, which is what light under the skin looks like;
 * and keep ambient light out of folds by the `openness` of each vertex.
 */
function lit(made, [r, g, b], floor = 0.25, wet = false) {
  const wrap = `vec3(${r.toFixed(3)}, ${g.toFixed(3)}, ${b.toFixed(3)})`;
  made.onBeforeCompile = (shader) => {
    const change = (kind, from, to) => { shader[kind] = shader[kind].replace(from, to); };
    change("vertexShader", "void main() {", "attribute float openness; varying float openness_;\nvoid main() {\n openness_ = openness;");
    change("fragmentShader", "void main() {", "varying float openness_;\nvoid main() {");
    change("fragmentShader", "#include <aomap_fragment>", `#include <aomap_fragment>
      float open = max(openness_, ${floor.toFixed(2)}), shine = ${wet ? "1.0" : "open"};
      vec3 bounce = vec3(open) / (1.0 - diffuseColor.rgb * 0.7 * (1.0 - open)); // light between near surfaces takes their colour
      reflectedLight.indirectDiffuse *= bounce; reflectedLight.indirectSpecular *= shine;
      reflectedLight.directDiffuse *= mix(vec3(1.0), bounce, 0.6); reflectedLight.directSpecular *= shine;`);
    const chunk = THREE.ShaderChunk.lights_physical_pars_fragment, plain = "vec3 irradiance = dotNL * directLight.color;";
    if (!chunk.includes(plain)) return; // another three.js: it still looks right, only less warm
    const soft = `vec3 sharp = dotNL * directLight.color; float facing = dot(geometryNormal, directLight.direction);
      vec3 irradiance = max(vec3(0.0), (vec3(facing) + ${wrap}) / ((1.0 + ${wrap}) * (1.0 + ${wrap}))) * directLight.color;`;
    change("fragmentShader", "#include <lights_physical_pars_fragment>",
      chunk.replace(plain, soft).replaceAll("reflectedLight.directSpecular += irradiance *", "reflectedLight.directSpecular += sharp *"));
  };
  made.customProgramCacheKey = () => `${wrap} ${floor} ${wet}`;
  return made;
}

/** Colours as they are, darker towards the outline and grey in it, so that dark ones stand out: for heat maps that must match their bar. */
export function flat() {
  const made = new THREE.MeshBasicMaterial({ vertexColors: true, toneMapped: false, side: THREE.DoubleSide });
  made.onBeforeCompile = (shader) => {
    shader.vertexShader = shader.vertexShader
      .replace("void main() {", "varying vec3 facing; varying vec3 toEye; void main() {")
      .replace("#include <project_vertex>", "#include <project_vertex>\n facing = normalMatrix * normal; toEye = -mvPosition.xyz;");
    shader.fragmentShader = shader.fragmentShader
      .replace("void main() {", "varying vec3 facing; varying vec3 toEye; void main() {")
      .replace("#include <opaque_fragment>", `float front = abs(dot(normalize(facing), normalize(toEye)));
      outgoingLight = mix(outgoingLight * mix(0.42, 1.0, smoothstep(0.0, 0.62, front)), vec3(0.42), 0.5 * (1.0 - smoothstep(0.04, 0.3, front)));
      #include <opaque_fragment>`);
  };
  return made;
}
