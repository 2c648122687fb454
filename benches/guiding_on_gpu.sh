#!/usr/bin/env bash
# What docs/GUIDING.md claims about guiding on a GPU, in one session: efficiency against plain tracing, equal samples,
# z-tests against the independent images, Bansal's bias.
#   cargo build --release && cargo bench --no-run --bench efficiency
#   QTRACER=target/release/qtracer EFFICIENCY=target/release/deps/efficiency-HASH \
#   REFERENCES=DIR_WITH_MITSUBA_EXR OUT=benches/results/DATE-DEVICE benches/guiding_on_gpu.sh [door|seed5|indirect|equal|references|scenes|long]…
set -u
: "${QTRACER:?}" "${EFFICIENCY:?}" "${OUT:?}"
parts=${*:-door seed5 indirect equal references scenes long}
mkdir -p "$OUT"
scratch=$(mktemp -d)
rows="$OUT/guiding.jsonl"
"$QTRACER" info > "$OUT/device.txt"

# efficiency SCENE SEEDS SECONDS VARIANT… [-- OPTION…]: a table; errors are relMSE by the scatter between seeds.
efficiency() {
  local scene=$1 seeds=$2 seconds=$3; shift 3
  echo; "$EFFICIENCY" --engine wavefront --scene "scenes/$scene.toml" --seeds "$seeds" --seconds "$seconds" --json "$rows" --variant "$@"
}

door() {
  efficiency door-ajar 10 1,4 auto off:throughput:16 --epsilon 1e-4
  efficiency door-ajar 5 1 off:throughput:1 off:throughput:4 off:off off:learnt adaptive octant --epsilon 1e-4
}
seed5() {
  efficiency bansal-room-5 10 4 auto off:throughput:4
  efficiency bansal-room-5 3 1 auto off:throughput:1 off:throughput:4 off:throughput:16 off:off off:learnt adaptive octant
}
indirect() { # no direct light
  efficiency door-ajar 2 4 auto off:throughput:4 off:throughput:16 --epsilon 1e-4 --direct-light false
}
equal() { # equal samples, no roulette, learning included
  for variant in adaptive:off octant:off off:off; do
    "$EFFICIENCY" --engine wavefront --scene scenes/door-ajar.toml --size 128 128 --seeds 10 --spp 1024 --epsilon 1e-4 --json "$rows" --variant $variant
  done
}
references() {
  for pair in cornell-box:cornell bansal-room-1:seed1 bansal-room-5:seed5 door-ajar:door glass-caustic:caustic; do
    local size=256x256; [[ $pair == bansal* ]] && size=320x240
    for guide in adaptive octant bansal-reweighted bansal; do
      local roulette=learnt spp=4096; [[ $guide == bansal* ]] && roulette=throughput && spp=1024
      "$QTRACER" render "scenes/${pair%:*}.toml" --engine wavefront --size $size --spp $spp --sampler independent \
        --direct-light on --max-bounces 64 --guide $guide --roulette $roulette --no-features -q -o "$scratch/ours.exr" 2>/dev/null
      echo "## ${pair%:*}, guide $guide, roulette $roulette, $spp samples a pixel"
      "$QTRACER" compare "$scratch/ours.exr" "$REFERENCES/${pair#*:}.exr" --z-test 2>/dev/null; echo "exit $?"; echo
    done
  done
}
scenes() {
  for scene in bansal-exp-1 bansal-exp-3 bansal-room-1 cornell-box glass-caustic glossy-box many-lights; do
    efficiency $scene 2 4 auto off:throughput:4
    efficiency $scene 2 1 off:throughput:1 off:throughput:16 off:off
  done
  for scene in bansal-exp-2 furnace-closed-50 furnace-closed-90 furnace-open furnace-open-half; do
    efficiency $scene 2 1 auto off:throughput:4
  done
}
long() { efficiency door-ajar 2 16 auto --epsilon 1e-4; efficiency bansal-room-5 2 16 auto; }

for part in $parts; do $part 2>&1 | tee "$OUT/guiding-$part.md"; done
rm -rf "$scratch"
