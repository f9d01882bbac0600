/** The mission's metric frame on the map's sphere: x along a bearing, y to its left, about the origin or about 0, 0. */

const EARTH_RADIUS_M = 6371008.8; // the sphere that the map's scale bar measures on
const DEGREES = 180 / Math.PI;

export class Frame {
  /** @param {Object} mission a MissionPicture */
  constructor(mission) {
    [this.latitude_deg, this.longitude_deg] = mission.origin_deg ?? [0, 0];
    const bearing = mission.x_bearing_deg / DEGREES;
    this.x_bearing_deg = mission.x_bearing_deg;
    this.cosine = Math.cos(bearing);
    this.sine = Math.sin(bearing);
    this.parallel = Math.cos(this.latitude_deg / DEGREES);
  }

  /** Longitude and latitude, in degrees, of a point in metres. @param {number[]} point_m */
  lonLat([x_m, y_m]) {
    const north_m = this.cosine * x_m + this.sine * y_m;
    const east_m = this.sine * x_m - this.cosine * y_m;
    const latitude_deg = this.latitude_deg + (north_m / EARTH_RADIUS_M) * DEGREES;
    return [this.longitude_deg + (east_m / (EARTH_RADIUS_M * this.parallel)) * DEGREES, latitude_deg];
  }

  /** The clockwise rotation from north, in degrees, of a yaw or direction that is counter-clockwise from x. */
  bearing_deg(yaw_rad) {
    return this.x_bearing_deg - yaw_rad * DEGREES;
  }
}
