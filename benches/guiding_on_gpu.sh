#!/usr/bin/env bash
# What docs/GUIDING.md claims about guiding on a GPU, in one session: efficiency against plain tracing, equal samples,
# z-tests against the independent images, Bansal's bias, what a guide adds to a sample. Each part of the first two has a folder of its own with rows, a
# table and a page.
#   cargo build --release && cargo bench --no-run --bench speed_vs_error
#   QTRACER=target/release/qtracer SPEED_VS_ERROR=target/release/deps/speed_vs_error-HASH \
#   REFERENCES=DIR_WITH_MITSUBA_EXR OUT=benches/results/DATE-DEVICE benches/guiding_on_gpu.sh [door-main|door|seed5-main|seed5|indirect|equal|references|scenes|cost|long]…
set -u
: "${QTRACER:?}" "${SPEED_VS_ERROR:?}" "${OUT:?}"
parts=${*:-door seed5 indirect equal references scenes cost long}
mkdir -p "$OUT"
scratch=$(mktemp -d)
"$QTRACER" info > "$OUT/device.txt"

# efficiency PART SCENE SEEDS SECONDS VARIANT… [--OPTION…]: rows, table and page in OUT/PART; errors by the scatter between seeds.
efficiency() {
  local part=$1 scene=$2 seeds=$3 seconds=$4; shift 4
  "$SPEED_VS_ERROR" --engines auto --scenes "scenes/$scene.toml" --size 640 480 --no-reference --seeds "$seeds" \
    --seconds "$seconds" --title "Guiding: $part" --out "$OUT/$part" --variants "$@" > "$OUT/$part.log"
}

door-main() { efficiency door door-ajar 10 1,4 auto off:throughput:16 --epsilon 1e-4; }
door() {
  door-main
  efficiency door-1s door-ajar 5 1 off:throughput:1 off:throughput:4 off:off off:learnt adaptive octant --epsilon 1e-4
}
seed5-main() { efficiency seed5 bansal-room-5 10 1,4 auto off:throughput:4; }
seed5() {
  seed5-main
  efficiency seed5-1s bansal-room-5 3 1 auto off:throughput:1 off:throughput:4 off:throughput:16 off:off off:learnt adaptive octant
}
indirect() { # no direct light
  efficiency indirect door-ajar 2 4 auto off:throughput:4 off:throughput:16 --epsilon 1e-4 --direct-light off
}
equal() { # equal samples, no roulette, learning included
  "$SPEED_VS_ERROR" --engines auto --scenes scenes/door-ajar.toml --size 128 128 --no-reference --seeds 10 --spp 1024 \
    --epsilon 1e-4 --title "Guiding: equal samples" --out "$OUT/equal" --variants adaptive:off octant:off off:off > "$OUT/equal.log"
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
  done | tee "$OUT/references.md"
}
scenes() { # every scene, or those in SCENES: what auto keeps of plain tracing's efficiency; some 20 s each
  for scene in ${SCENES:-$(basename -s .toml scenes/*.toml)}; do
    local seeds=2
    case $scene in
      door-ajar | bansal-room-5) continue ;; # parts of their own
      still-life | glossy-box | bansal-exp-2 | bansal-exp-3) seeds=4 ;; # near the bound
    esac
    efficiency scenes "$scene" $seeds 4 auto off:throughput:4
  done
}
cost() { # what a guide adds to a sample, nothing said of errors
  local guide="$scratch/octant.guide" plain="scenes/door-ajar.toml --size 640x480 --engine wavefront --direct-light on --max-bounces 64 --roulette off --no-features -q"
  "$QTRACER" render $plain --spp 64 --guide octant --guide-learning 64 --save-guide "$guide" -o "$scratch/learnt.exr" 2>/dev/null
  {
    echo "| door-ajar, wavefront, no roulette, 4 s | ns a ray | rays a path | ns a sample | samples |"; echo "|---|---|---|---|---|"
    for _ in 1 2 3; do
      for way in "off" "octant --load-guide $guide --guide-learning 0 --seed 2" "octant" "adaptive"; do
        "$QTRACER" render $plain --time 4s --guide $way --stats json -o "$scratch/cost.exr" 2>/dev/null |
          WAY="${way%% --load*}$([[ $way == *load* ]] && echo ", loaded")" python3 -c 'import json,os,sys
d = json.load(sys.stdin); ns, rays, paths = 1e9 * d["gpu_seconds"], d["rays"], d["paths"]
print("| %s | %.4f | %.1f | %.3f | %d |" % (os.environ["WAY"], ns / rays, rays / paths, ns / paths, d["samples"]))'
      done
    done
  } | tee "$OUT/cost.md"
}
long() { efficiency long door-ajar 2 16 auto --epsilon 1e-4; efficiency long bansal-room-5 2 16 auto; }

for part in $parts; do $part; done
rm -rf "$scratch"
