/** Third octaves of base ten (IEC 61260-1), as the server has them in tactile/texture/bands.py. */

/** A band from 10^−0.05 to 10^0.05 times its center. */
export interface Band {
  readonly center_hz: number;
  /** Rounded center, by which the band is named. */
  readonly nominal_hz: number;
  readonly from_hz: number;
  readonly to_hz: number;
}

/** Rounded centers of the bands of a decade. */
const NOMINAL = [1, 1.25, 1.6, 2, 2.5, 3.15, 4, 5, 6.3, 8];

/** The bands 10 Hz … 1 kHz. */
export const BANDS: readonly Band[] = Array.from({ length: 21 }, (_, k) => {
  const center_hz = 10 ** (1 + k / 10);
  return {
    center_hz,
    nominal_hz: 10 ** (1 + Math.floor(k / 10)) * (NOMINAL[k % 10] as number),
    from_hz: center_hz * 10 ** -0.05,
    to_hz: center_hz * 10 ** 0.05,
  };
});

/**
 * Add up the lines of a spectrum in a band, each multiplied by a weight.
 *
 * A line stands for all frequencies up to halfway to its neighbors. One on an edge is shared
 * between both bands, since bands of few lines would otherwise be too wide or too narrow.
 *
 * @param lines Mean squares, the first at 0 Hz.
 * @param resolution_hz Distance of the lines [Hz].
 * @param weight Weight of a line at a frequency [Hz].
 */
export function bandPower(
  lines: Float64Array,
  resolution_hz: number,
  { from_hz, to_hz }: Band,
  weight: (frequency_hz: number) => number = () => 1,
): number {
  const [from, to] = [from_hz / resolution_hz, to_hz / resolution_hz];
  let sum = 0;
  for (let k = Math.round(from); k < to + 0.5; k++) {
    const share = Math.min(k + 0.5, to) - Math.max(k - 0.5, from);
    sum += Math.max(share, 0) * (lines[k] ?? 0) * weight(k * resolution_hz);
  }
  return sum;
}
