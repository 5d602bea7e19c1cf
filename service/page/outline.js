// The outline of the projectile in a meridian plane, with noses as solver/projectile.py defines them.

const ARC_POINTS = 24;
const MATCH = 1e-5; // relative tolerance within which a profile ends at the radius of the shank

/**
 * Return the upper half of the outline, from the nose tip to the rear edge.
 *
 * @param {object} projectile as in a request
 * @returns {[number, number][]} distances behind the tip and from the axis [m]
 */
export function upperOutline({ nose, diameter_m: diameter, length_m: length, boat_tail: tail }) {
  const radius = diameter / 2;
  const ahead = NOSES[nose.shape](nose, radius);
  if (ahead.at(-1)[1] < radius * (1 - MATCH)) return ahead; // the nose is the whole body
  if (!tail) return [...ahead, [length, radius]];
  return [...ahead, [length - tail.length_m, radius], [length, tail.base_diameter_m / 2]];
}

/** Return the whole outline as a closed polygon [m]. */
export function closedOutline(projectile) {
  const upper = upperOutline(projectile);
  const lower = upper.map(([x, r]) => [x, -r]).reverse();
  return [...upper, ...lower, upper[0]];
}

/** Return the distance of the centre of gravity behind the tip [m]: as given, or else that of a homogeneous solid. */
export function centreOfGravity(projectile) {
  const { volume, moment } = integrals(upperOutline(projectile));
  return projectile.center_of_gravity_m ?? moment / volume;
}

/**
 * Move an outline to where the projectile is at an instant.
 *
 * @param {[number, number][]} outline distances behind the tip and from the axis [m]
 * @param {{lateral: number, depth: number, angle: number}} tip position of the tip [m] and axis angle [rad]
 * @returns {{x: number[], y: number[]}} distances along the face, and depths [m]
 */
export function placed(outline, { lateral, depth, angle }) {
  const [cosine, sine] = [Math.cos(angle), Math.sin(angle)];
  return {
    x: outline.map(([behind, off]) => lateral - behind * sine + off * cosine),
    y: outline.map(([behind, off]) => depth - behind * cosine - off * sine),
  };
}

const NOSES = {
  ogive({ caliber_radius_head: psi }, radius) {
    const arc = 2 * radius * psi;
    const length = radius * Math.sqrt(4 * psi - 1);
    const start = Math.atan2(length, arc - radius);
    return fractions((t) => {
      const angle = start * (1 - t);
      return [length - arc * Math.sin(angle), radius - arc + arc * Math.cos(angle)];
    });
  },
  conical: ({ length_to_diameter: slenderness }, radius) => [
    [0, 0],
    [2 * radius * slenderness, radius],
  ],
  spherical({ caliber_radius_head: psi }, radius) {
    const sphere = 2 * radius * psi;
    const end = Math.asin(radius / sphere);
    return fractions((t) => [sphere * (1 - Math.cos(t * end)), sphere * Math.sin(t * end)]);
  },
  flat: (_, radius) => [
    [0, 0],
    [0, radius],
  ],
  sphere: (_, radius) => fractions((t) => [radius * (1 - Math.cos(Math.PI * t)), radius * Math.sin(Math.PI * t)]),
  profile: ({ points }) => (points[0][1] > 0 ? [[0, 0], ...points] : points),
};

function fractions(at) {
  return Array.from({ length: ARC_POINTS + 1 }, (_, i) => at(i / ARC_POINTS));
}

/** Return the volume of the body as if it had no cavity [m³]. */
export function solidVolume(projectile) {
  if (projectile.nose.shape === "sphere") return (Math.PI / 6) * projectile.diameter_m ** 3; // its outline has 0.4 % less
  return (Math.PI / 3) * integrals(upperOutline(projectile)).volume;
}

/** Return the volume of a chain of frustums and its first moment about the tip, both divided by π / 3. */
function integrals(upper) {
  let [volume, moment] = [0, 0];
  for (let i = 1; i < upper.length; i += 1) {
    const [[x, r], [end, s]] = [upper[i - 1], upper[i]];
    const slice = (end - x) * (r * r + r * s + s * s);
    volume += slice;
    if (slice > 0) moment += slice * x + ((end - x) ** 2 * (r * r + 2 * r * s + 3 * s * s)) / 4;
  }
  return { volume, moment };
}
