/**
 * The mission's metric frame on the map: x along a bearing, y to its left.
 *
 * A mission with an origin is drawn at its true place, so that map tiles need no conversion. Its metres are converted
 * to degrees with the radii of the WGS-84 ellipsoid there: within 0.1 m up to 500 m from an origin below 1000 m altitude.
 * The map's own sphere has an error of 1.5 m at latitude 47. A mission without an origin is drawn at 0, 0 on that sphere.
 */

const SPHERE_RADIUS_M = 6371008.8; // the sphere of the map's scale bar
const ELLIPSOID = { equator_m: 6378137, eccentricity_squared: 6.69437999014e-3 };
const DEGREES = 180 / Math.PI;

export class Frame {
  /** @param {Object} mission a MissionPicture */
  constructor(mission) {
    [this.latitude_deg, this.longitude_deg] = mission.origin_deg ?? [0, 0];
    const bearing = mission.x_bearing_deg / DEGREES;
    this.x_bearing_deg = mission.x_bearing_deg;
    this.cosine = Math.cos(bearing);
    this.sine = Math.sin(bearing);
    const [meridian_m, normal_m] = mission.origin_deg ? radii(this.latitude_deg / DEGREES) : [SPHERE_RADIUS_M, SPHERE_RADIUS_M];
    this.north_m_deg = meridian_m / DEGREES;
    this.east_m_deg = (normal_m * Math.cos(this.latitude_deg / DEGREES)) / DEGREES;
  }

  /** Longitude and latitude, in degrees, of a point in metres. @param {number[]} point_m */
  lonLat([x_m, y_m]) {
    const north_m = this.cosine * x_m + this.sine * y_m;
    const east_m = this.sine * x_m - this.cosine * y_m;
    return [this.longitude_deg + east_m / this.east_m_deg, this.latitude_deg + north_m / this.north_m_deg];
  }

  /** The point in metres of a longitude and a latitude in degrees: the inverse of `lonLat`. */
  point_m([longitude_deg, latitude_deg]) {
    const north_m = (latitude_deg - this.latitude_deg) * this.north_m_deg;
    const east_m = (longitude_deg - this.longitude_deg) * this.east_m_deg;
    return [this.cosine * north_m + this.sine * east_m, this.sine * north_m - this.cosine * east_m];
  }

  /** The clockwise rotation from north, in degrees, of a yaw or direction that is counter-clockwise from x. */
  bearing_deg(yaw_rad) {
    return this.x_bearing_deg - yaw_rad * DEGREES;
  }
}

/** The ellipsoid's radii of curvature at a latitude, in metres: along the meridian, and across it. */
function radii(latitude_rad) {
  const { equator_m, eccentricity_squared } = ELLIPSOID;
  const flattened = 1 - eccentricity_squared * Math.sin(latitude_rad) ** 2;
  return [(equator_m * (1 - eccentricity_squared)) / flattened ** 1.5, equator_m / Math.sqrt(flattened)];
}
