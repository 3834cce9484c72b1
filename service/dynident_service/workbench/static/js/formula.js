// The catalogue's formulas: from LaTeX to MathML.

const MATHML = "http://www.w3.org/1998/Math/MathML";
const SYMBOLS = {
  Gamma: "Γ", tau: "τ", delta: "δ", Delta: "Δ", omega: "ω", phi: "φ", varphi: "φ", epsilon: "ϵ", varepsilon: "ε", theta: "θ", alpha: "α", beta: "β", gamma: "γ", sigma: "σ", rho: "ρ", eta: "η", mu: "μ", lambda: "λ", pi: "π", xi: "ξ", kappa: "κ", chi: "χ", psi: "ψ",
  pm: "±", mp: "∓", cdot: "·", times: "×", leftarrow: "←", rightarrow: "→", le: "≤", ge: "≥", approx: "≈", sum: "∑", int: "∫", partial: "∂", infty: "∞",
};
const FUNCTIONS = new Set(["cos", "sin", "tan", "tanh", "exp", "ln", "log", "min", "max", "sign", "sat"]);
const ACCENTS = { dot: "˙", ddot: "¨", hat: "^", bar: "¯", tilde: "~" };
const SPACES = { ",": "0.17em", ";": "0.28em", " ": "0.25em", quad: "1em", qquad: "2em", "!": "0" };

/** A formula to be shown; the text itself where it says something that is not known here. */
export function formula(text) {
  try {
    const tokens = text.match(/\\[A-Za-z]+|\\.|[0-9.]+|[A-Za-z]|\S/g) ?? [];
    const root = make("math", {}, rowOf(tokens, null));
    root.setAttribute("aria-label", text);
    return root;
  } catch {
    const code = document.createElement("code");
    code.textContent = text;
    return code;
  }
}

function rowOf(tokens, end) {
  const parts = [];
  while (tokens.length) {
    if (tokens[0] === end) {
      tokens.shift();
      return make("mrow", {}, ...parts);
    }
    if (tokens[0] === "_" || tokens[0] === "^") parts.push(scripted(tokens, parts.pop()));
    else parts.push(atom(tokens));
  }
  if (end !== null) throw new SyntaxError(`no ${end}`);
  return make("mrow", {}, ...parts);
}

function scripted(tokens, base) {
  const scripts = {};
  while (tokens[0] === "_" || tokens[0] === "^") scripts[tokens.shift()] = atom(tokens);
  const tag = scripts._ && scripts["^"] ? "msubsup" : scripts._ ? "msub" : "msup";
  return make(tag, {}, base ?? make("mrow", {}), ...[scripts._, scripts["^"]].filter(Boolean));
}

function atom(tokens) {
  const token = tokens.shift();
  if (token === undefined) throw new SyntaxError("nothing follows");
  if (token === "{") return rowOf(tokens, "}");
  if (token.startsWith("\\")) return command(token.slice(1), tokens);
  if (/^[0-9.]+$/.test(token)) return leaf("mn", token);
  if (/^[A-Za-z]$/.test(token)) return leaf("mi", token);
  if ("()[]|".includes(token)) return leaf("mo", token, { stretchy: "false", lspace: "0", rspace: "0" });
  return leaf("mo", token === "-" ? "−" : token);
}

function command(name, tokens) {
  if (name in SYMBOLS) return leaf(/[^\p{L}]/u.test(SYMBOLS[name]) ? "mo" : "mi", SYMBOLS[name]);
  if (FUNCTIONS.has(name)) return leaf("mi", name, { mathvariant: "normal" });
  if (name in SPACES) return make("mspace", { width: SPACES[name] });
  if (name in ACCENTS) return make("mover", { accent: "true" }, atom(tokens), leaf("mo", ACCENTS[name]));
  if (name === "left" || name === "right") return leaf("mo", tokens.shift() ?? "", { stretchy: "true" });
  if (name === "frac") return make("mfrac", {}, atom(tokens), atom(tokens));
  if (name === "sqrt") return make("msqrt", {}, atom(tokens));
  if (name === "mathrm" || name === "text" || name === "operatorname") return upright(tokens);
  throw new SyntaxError(`\\${name} is not known`);
}

function upright(tokens) {
  const close = tokens.indexOf("}");
  if (tokens[0] !== "{" || close < 0) throw new SyntaxError("a group is missing");
  const word = tokens.splice(0, close + 1).slice(1, -1).join("");
  return leaf("mi", word, { mathvariant: "normal" });
}

function leaf(tag, text, props = {}) {
  const made = make(tag, props);
  made.textContent = text;
  return made;
}

function make(tag, props, ...children) {
  const made = document.createElementNS(MATHML, tag);
  for (const [name, value] of Object.entries(props)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}
