// Dimensions as expressions of a body's measures, such as `chest/4 + 2`: centimetres. No code of the page is ever run by
// them. The same rules as vitruvian.cloth.dimensions.

const LONGEST = 200, DEEPEST = 50;
const FUNCTIONS = { min: Math.min, max: Math.max, sqrt: Math.sqrt, abs: Math.abs };

/** The value in centimetres of an expression; `measures` in metres. Throws an Error with one line. */
export function evaluate(text, measures = {}) {
  if (text.length > LONGEST) throw new Error(`expected at most ${LONGEST} characters`);
  const words = tokens(text);
  let at = 0;
  const peek = () => words[at], take = () => words[at++];
  const sum = (deep) => {
    let value = product(deep);
    while (peek() === "+" || peek() === "-") value = take() === "+" ? value + product(deep) : value - product(deep);
    return value;
  };
  const product = (deep) => {
    let value = signed(deep);
    while (peek() === "*" || peek() === "/") value = take() === "*" ? value * signed(deep) : value / signed(deep);
    return value;
  };
  const signed = (deep) => {
    if (deep > DEEPEST) throw new Error("expected fewer brackets");
    if (peek() === "-") { take(); return -signed(deep + 1); }
    if (peek() === "+") { take(); return signed(deep + 1); }
    return atom(deep);
  };
  const atom = (deep) => {
    const word = take();
    if (word === undefined) throw new Error("it ends too early");
    if (word === "(") { const value = sum(deep + 1); close(); return value; }
    if (typeof word === "number") return word;
    if (!/^[a-z]/i.test(word)) throw new Error(`expected a number or a measure, found ${word}`);
    if (peek() === "(") {
      if (!Object.hasOwn(FUNCTIONS, word)) throw new Error(`no function ${word}: there are ${Object.keys(FUNCTIONS).join(", ")}`);
      take();
      const values = [sum(deep + 1)];
      while (peek() === ",") { take(); values.push(sum(deep + 1)); }
      close();
      if ((word === "sqrt" || word === "abs") && values.length > 1) throw new Error(`${word} takes one number`);
      return FUNCTIONS[word](...values);
    }
    if (!Object.hasOwn(measures, word)) throw new Error(`no measure ${word}: there are ${Object.keys(measures).sort().join(", ") || "none"}`);
    return 100 * measures[word];
  };
  const close = () => { if (take() !== ")") throw new Error("expected a closing bracket"); };
  const value = sum(0);
  if (at < words.length) throw new Error(`did not expect ${words[at]}`);
  if (!Number.isFinite(value)) throw new Error("it has no value");
  return value;
}

function tokens(text) {
  const out = [], shape = /\s*(?:(\d+(?:\.\d*)?|\.\d+)|([A-Za-z_]\w*)|([-+*/(),]))/y;
  const whole = text.trimEnd();
  while (shape.lastIndex < whole.length) {
    const at = shape.lastIndex, found = shape.exec(whole);
    if (!found) throw new Error(`did not expect ${whole.slice(at).trim()[0]}`);
    out.push(found[1] !== undefined ? Number(found[1]) : found[2] ?? found[3]);
  }
  if (!out.length) throw new Error("expected a length");
  return out;
}

/** Is it more than a plain number? Then it is kept, to be evaluated anew for another body. */
export const named = (text) => /[a-z_]/i.test(text);
