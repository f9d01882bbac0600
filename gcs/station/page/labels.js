/** Places for the labels of symbols: none covers another label or a symbol, nor a name if there is room. A label without room is hidden. */

const SYMBOL_PX = 14; // from its middle to its edge
const GAP_PX = 4;
const CHARACTER_PX = 9;
const HEIGHT_PX = 24;
const NAME_CHARACTER_PX = 8;
const NAME_HEIGHT_PX = 20;
const NAME_COST = 0.1; // of a label: that of a vehicle over a name is better than none
const PLACES = ["right", "left", "above", "below"];
export const NO_PLACE = "none";

/**
 * Return the place of each label, in the order given: the first symbols have the first choice.
 * @param {{x: number, y: number, text: string, place: string, isKept: boolean}[]} symbols in pixels; `place` is the one
 *   that it has, which it keeps while there is room; a label that `isKept` is never hidden
 * @param {number[]} size of the map in pixels, width and height
 * @param {{x: number, y: number, text: string}[]} names of areas, by their middles, which stay where they are
 */
export function labelPlaces(symbols, [width, height], names) {
  const taken = symbols.map(({ x, y }) => box(x, y, SYMBOL_PX, SYMBOL_PX));
  const named = names.map(({ x, y, text }) => box(x, y, (text.length * NAME_CHARACTER_PX) / 2, NAME_HEIGHT_PX / 2));
  return symbols.map((symbol, index) => {
    const others = taken.filter((_, other) => other !== index);
    const wanted = PLACES.toSorted((one, other) => (other === symbol.place) - (one === symbol.place));
    const cost = (place) => crowding(labelBox(symbol, place), others, named, width, height);
    const best = wanted.reduce((one, other) => (cost(other) < cost(one) ? other : one));
    const place = symbol.isKept || cost(best) < 1 ? best : NO_PLACE;
    if (place !== NO_PLACE) taken.push(labelBox(symbol, place));
    return place;
  });
}

/** How many boxes a box covers, where a name counts little; one that leaves the map counts as covering all. */
function crowding(label, others, named, width, height) {
  const [left, right, top, bottom] = label;
  const isInside = left > 0 && right < width && top > 0 && bottom < height;
  const covered = (boxes) => boxes.filter((other) => overlap(label, other)).length;
  return isInside ? covered(others) + NAME_COST * covered(named) : others.length + 1;
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
