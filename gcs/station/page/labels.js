/** Places for the labels of symbols: none covers another label, a symbol or a zone's name. A label without room is hidden. */

const SYMBOL_PX = 14; // from its middle to its edge
const GAP_PX = 4;
const CHARACTER_PX = 9;
const HEIGHT_PX = 24;
const PLACES = ["right", "left", "above", "below"];
export const NO_PLACE = "none";

/**
 * Return the place of each label, in the order given: the first symbols have the first choice.
 * @param {{x: number, y: number, text: string, place: string, isKept: boolean}[]} symbols in pixels; `place` is the one
 *   that it has, which it keeps while there is room; a label that `isKept` is never hidden
 * @param {number[]} size of the map in pixels, width and height
 * @param {{x: number, y: number, text: string}[]} names that stay where they are, by their middles
 */
export function labelPlaces(symbols, [width, height], names) {
  const taken = symbols.map(({ x, y }) => box(x, y, SYMBOL_PX, SYMBOL_PX));
  taken.push(...names.map(({ x, y, text }) => box(x, y, (text.length * CHARACTER_PX) / 2, HEIGHT_PX / 2)));
  return symbols.map((symbol, index) => {
    const others = taken.filter((_, other) => other !== index);
    const wanted = PLACES.toSorted((one, other) => (other === symbol.place) - (one === symbol.place));
    const cost = (place) => crowding(labelBox(symbol, place), others, width, height);
    const best = wanted.reduce((one, other) => (cost(other) < cost(one) ? other : one));
    const place = symbol.isKept || cost(best) === 0 ? best : NO_PLACE;
    if (place !== NO_PLACE) taken.push(labelBox(symbol, place));
    return place;
  });
}

/** How many boxes a box covers; one that leaves the map counts as covering all. */
function crowding(label, others, width, height) {
  const [left, right, top, bottom] = label;
  const isInside = left > 0 && right < width && top > 0 && bottom < height;
  return isInside ? others.filter((other) => overlap(label, other)).length : others.length + 1;
}

function labelBox({ x, y, text }, place) {
  const half = (text.length * CHARACTER_PX) / 2;
  const aside = SYMBOL_PX + GAP_PX;
  const [dx, dy] = { right: [aside + half, 0], left: [-aside - half, 0], above: [0, -aside - HEIGHT_PX / 2], below: [0, aside + HEIGHT_PX / 2] }[place];
  return box(x + dx, y + dy, half, HEIGHT_PX / 2);
}

const box = (x, y, half_width, half_height) => [x - half_width, x + half_width, y - half_height, y + half_height];

const overlap = ([left, right, top, bottom], [left2, right2, top2, bottom2]) =>
  left < right2 && left2 < right && top < bottom2 && top2 < bottom;
