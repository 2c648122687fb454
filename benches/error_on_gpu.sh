#!/usr/bin/env bash
# Error against time on a GPU: engines and guides on the five scenes that have references, with Mitsuba's points if there is one.
# Rows, table and page in OUT; a part is a scene, so a session that is cut short can go on with the next one.
#   cargo bench --no-run --bench speed_vs_error
#   SPEED_VS_ERROR=target/release/deps/speed_vs_error-HASH REFERENCES=DIR_WITH_MITSUBA_EXR OUT=benches/results/DATE-DEVICE-error \
#   [MITSUBA=PYTHON_WITH_MITSUBA] benches/error_on_gpu.sh [cornell-box|bansal-room-1|bansal-room-5|door-ajar|glass-caustic|speed]…
# SEEDS, BUDGET (seconds a render), ENGINES and VARIANTS can be set; a scene takes about
# engines × variants × seeds × (budget + 0.5) seconds. `speed` is samples per second at 640×480, errors between seeds.
set -u
: "${SPEED_VS_ERROR:?}" "${REFERENCES:?}" "${OUT:?}"
seeds=${SEEDS:-10} budget=${BUDGET:-1} engines=${ENGINES:-fused,mega}
variants=${VARIANTS:-off:off off:throughput:4 auto}
scenes="cornell-box bansal-room-1 bansal-room-5 door-ajar glass-caustic"
parts=${*:-$scenes speed}

# The same estimator for the peer: direct light and MIS, 64 levels, no roulette.
mitsuba() {
  [ -z "${MITSUBA:-}" ] || "$MITSUBA" benches/peers/mitsuba_peer.py --variants cuda_ad_rgb --seeds "$seeds" --budget "$budget" "$@"
}

for part in $parts; do
  if [ "$part" = speed ]; then
    # shellcheck disable=SC2086 # a list
    "$SPEED_VS_ERROR" --engines "$engines" --variants off:off --independent --no-reference --size 640 480 --max-bounces 64 \
      --scenes $(printf 'scenes/%s.toml ' $scenes) --seeds 3 --budget "$budget" --checks 3 --out "$OUT/speed" > /dev/null
    mitsuba --speed --size 640 480 --checks 3 --out "$OUT/speed/mitsuba.jsonl"
    "$SPEED_VS_ERROR" --report "$OUT/speed" --out "$OUT/speed" --title "Samples per second, 640 × 480" > /dev/null
  else
    # shellcheck disable=SC2086 # a list
    "$SPEED_VS_ERROR" --engines "$engines" --variants $variants --references "$REFERENCES" --scenes "scenes/$part.toml" \
      --seeds "$seeds" --budget "$budget" --out "$OUT" > /dev/null
    mitsuba --references "$REFERENCES" --scenes "scenes/$part.toml" --out "$OUT/mitsuba.jsonl"
  fi
done
[ ! -e "$OUT/rows.jsonl" ] || "$SPEED_VS_ERROR" --report "$OUT" --out "$OUT"
