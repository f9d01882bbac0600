/** Shows the replay: unpacks the operator's page from this file, and opens it in the frame; its files become blobs. */

const TYPES = {
  css: "text/css", html: "text/html", js: "text/javascript", json: "application/json", mjs: "text/javascript", svg: "image/svg+xml",
};
/** Where a module names another file of the page: a blob has no files beside it, so the import map has to know the name. */
const REFERENCE = /(from |import\(|resolve\()"\.\//g;

const frame = document.querySelector("#replay iframe");
const missing = document.querySelector("#replay .missing");

async function unpacked(text) {
  const packed = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Response(stream).json();
}

function blobUrl(name, text) {
  const type = TYPES[name.slice(name.lastIndexOf(".") + 1)];
  const found = type === TYPES.js ? text.replaceAll(REFERENCE, '$1"page/') : text;
  return URL.createObjectURL(new Blob([found], { type }));
}

/** The page as one document. @param {Object<string, string>} files texts by name */
function assembled(files) {
  const urls = Object.fromEntries(Object.entries(files).map(([name, text]) => [name, blobUrl(name, text)]));
  const page = new DOMParser().parseFromString(files["index.html"], "text/html");
  for (const link of page.querySelectorAll("link")) link.setAttribute("href", urls[link.getAttribute("href")]);
  const script = page.querySelector("script");
  script.setAttribute("src", urls[script.getAttribute("src")]);
  const map = page.createElement("script");
  map.type = "importmap";
  map.textContent = JSON.stringify({ imports: Object.fromEntries(Object.entries(urls).map(([name, url]) => [`page/${name}`, url])) });
  script.before(map);
  return `<!doctype html>${page.documentElement.outerHTML}`;
}

try {
  if (!HTMLScriptElement.supports("importmap")) throw new Error("no import maps");
  frame.srcdoc = assembled(await unpacked(document.getElementById("replay-files").textContent));
  frame.hidden = false;
  missing.hidden = true;
} catch (error) {
  missing.textContent = `The replay is missing: this browser cannot open it (${error.message}).`;
}
