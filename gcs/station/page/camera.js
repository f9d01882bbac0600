/** The stream of a vehicle's camera: a link, and in a live flight its picture where the browser can show it. */

import { element } from "./dom.js";

const SHOWN = /^https?:/i;

/** The link to a stream; by HTTP also its picture, which is received only while it is open. */
export function cameraParts({ vehicle_id, camera_url }, { source }) {
  const stream = { class: "stream", href: camera_url, target: "_blank", rel: "noopener noreferrer" };
  const link = element("a", stream, `Camera of vehicle ${vehicle_id}`);
  if (!SHOWN.test(camera_url) || source === "log") return [link];
  const picture = element("details", { class: "picture" }, element("summary", {}, `Picture of vehicle ${vehicle_id}`));
  picture.addEventListener("toggle", () => {
    const shown = picture.querySelector("img, p");
    shown?.removeAttribute("src"); // else the browser goes on receiving it
    shown?.remove();
    if (picture.open) picture.append(pictureOf(vehicle_id, camera_url));
  });
  return [link, picture];
}

function pictureOf(vehicle_id, camera_url) {
  const shown = element("img", { alt: `What the camera of vehicle ${vehicle_id} sees`, src: camera_url });
  const failed = "This browser shows no picture of the stream: open its link, or check that the camera is on.";
  shown.addEventListener("error", () => shown.replaceWith(element("p", {}, failed)));
  return shown;
}
