/** Short functions to create and change elements. */

/**
 * Make an element with attributes and children; `false` and null leave an attribute out.
 * @param {string} name @param {Object<string, *>} attributes @param {...(Node|string)} children
 */
export function element(name, attributes = {}, ...children) {
  const made = document.createElement(name);
  for (const [key, value] of Object.entries(attributes)) {
    if (value !== false && value !== null) made.setAttribute(key, value === true ? "" : value);
  }
  made.append(...children);
  return made;
}

/** The same for an element of SVG. */
export function drawing(name, attributes) {
  const made = document.createElementNS("http://www.w3.org/2000/svg", name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  return made;
}

export const byId = (id) => document.getElementById(id);

/** Change a text only if it differs: an unchanged text is neither laid out nor read out again. */
export function setText(node, text) {
  if (node.textContent !== text) node.textContent = text;
}

/** Change an attribute only if it differs; null removes it. */
export function setAttribute(node, name, value) {
  if (node.getAttribute(name) === value) return;
  if (value === null) node.removeAttribute(name);
  else node.setAttribute(name, value);
}

/** The sign and the word of each severity: colour is never the only sign. */
export const SEVERITIES = {
  information: { sign: "●", word: "Information" },
  warning: { sign: "▲", word: "Warning" },
  alarm: { sign: "■", word: "ALARM" },
};
