/** The map tiles that the station serves, if any: a layer under the scene, its switch, and their attribution. */

import { byId, element } from "./dom.js";
import { isDark } from "./theme.js";

const LAYER = "tiles";
const TILE_PX = 256;
// Faint and pale: the ink of either theme keeps a contrast of 4.5 on black tiles and on white ones.
const OPACITY = { light: 0.4, dark: 0.35 };
const SATURATION = -0.4;
const EMPTY_PIXEL_RATIO = 1 / 16; // without tiles each pixel is empty: without a graphics card even these take time

export class Tiles {
  /** @param {Object} map MapLibre's map */
  constructor(map) {
    this.map = map;
    this.source = sourceControl();
  }

  /** Draw the tiles of a mission, and remove those of another one. @param {?Object} tiles a TilesPicture */
  start(tiles) {
    this.#clear();
    this.map.setPixelRatio(tiles ? null : EMPTY_PIXEL_RATIO); // null: the screen's
    if (!tiles) return;
    this.map.addSource(LAYER, source(tiles));
    const paint = { "raster-opacity": opacity(), "raster-saturation": SATURATION, "raster-fade-duration": 0 };
    this.map.addLayer({ id: LAYER, type: "raster", source: LAYER, paint });
    this.source.text.textContent = tiles.source;
    if (tiles.source) this.map.addControl(this.source, "bottom-left");
    this.label = element("label", {}, this.#box(), " Map tiles");
    byId("layers").querySelector("fieldset").append(this.label);
  }

  /** Set the opacity of the page's theme. */
  recolour() {
    if (this.map.getLayer(LAYER)) this.map.setPaintProperty(LAYER, "raster-opacity", opacity());
  }

  #clear() {
    if (!this.map.getLayer(LAYER)) return;
    this.map.removeLayer(LAYER);
    this.map.removeSource(LAYER);
    if (this.map.hasControl(this.source)) this.map.removeControl(this.source);
    this.label.remove();
  }

  #box() {
    const box = element("input", { type: "checkbox", value: LAYER, checked: true });
    const visibility = () => (box.checked ? "visible" : "none");
    box.addEventListener("change", () => this.map.setLayoutProperty(LAYER, "visibility", visibility()));
    return box;
  }
}

/** Beyond the deepest level its tiles are enlarged. In place of a missing tile one of a level above is shown, or the ground. */
function source({ level_min, level_max }) {
  const tiles = [`${new URL("tiles", document.baseURI)}/{z}/{x}/{y}`];
  return { type: "raster", tiles, tileSize: TILE_PX, minzoom: level_min, maxzoom: level_max };
}

const opacity = () => (isDark() ? OPACITY.dark : OPACITY.light);

/** A control of the map whose `text` is never parsed as HTML, unlike that of MapLibre's own control. */
function sourceControl() {
  const text = element("p", { class: "maplibregl-ctrl tiles-source" });
  return { text, onAdd: () => text, onRemove: () => text.remove() };
}
