// Metres east and north of a datum to WGS84, by the closed forms of `fieldgrid.geodesy`.

const A = 6378137.0;
const F = 1.0 / 298.257223563;
const E2 = F * (2.0 - F);
const B = A * (1.0 - F);

/** Latitude and longitude, degrees, of a point of the datum's tangent plane. */
export function toGeodetic(
  datum: { lat_deg: number; lon_deg: number; height_m: number },
  east: number,
  north: number,
): [lat: number, lon: number] {
  const lat0 = (datum.lat_deg * Math.PI) / 180;
  const lon0 = (datum.lon_deg * Math.PI) / 180;
  const [sinLat, cosLat] = [Math.sin(lat0), Math.cos(lat0)];
  const [sinLon, cosLon] = [Math.sin(lon0), Math.cos(lon0)];
  const normal = A / Math.sqrt(1.0 - E2 * sinLat * sinLat);
  const ring0 = (normal + datum.height_m) * cosLat;
  const outward = -sinLat * north;
  const x = ring0 * cosLon - sinLon * east + cosLon * outward;
  const y = ring0 * sinLon + cosLon * east + sinLon * outward;
  const z = (normal * (1.0 - E2) + datum.height_m) * sinLat + cosLat * north;
  const ring = Math.hypot(x, y);
  let reduced = Math.atan2(z * A, ring * B);
  let lat = 0;
  for (let pass = 0; pass < 2; pass++) {
    lat = Math.atan2(
      z + (E2 / (1.0 - E2)) * B * Math.sin(reduced) ** 3,
      ring - E2 * A * Math.cos(reduced) ** 3,
    );
    reduced = Math.atan2((1.0 - F) * Math.sin(lat), Math.cos(lat));
  }
  return [(lat * 180) / Math.PI, (Math.atan2(y, x) * 180) / Math.PI];
}
