#!/usr/bin/env bash
# Everything that issue-by-issue claims about a GPU rest on, in one session: times, identity of the engines, z-tests.
#   cargo build --release && cargo bench --no-run --bench engine_times
#   QTRACER=target/release/qtracer ENGINE_TIMES=target/release/deps/engine_times-HASH \
#   REFERENCES=DIR_WITH_MITSUBA_EXR OUT=benches/results/DATE-DEVICE benches/on_gpu.sh [times|identity|references]…
set -u
: "${QTRACER:?}" "${ENGINE_TIMES:?}" "${OUT:?}"
parts=${*:-times identity references}
mkdir -p "$OUT"
scratch=$(mktemp -d)
"$QTRACER" info | tee "$OUT/device.txt"

times() {
  local rows="$OUT/rows.jsonl" plain="--direct-light false --roulette false"
  rm -f "$rows"
  {
    echo "### Bansal's three experiments: 64 samples, 8 levels, no direct light, no roulette (as he timed them)"
    "$ENGINE_TIMES" --scene scenes/bansal-exp-{1,2,3}.toml $plain --json "$rows"
    echo; echo "### The same with roulette"
    "$ENGINE_TIMES" --scene scenes/bansal-exp-{1,2,3}.toml --direct-light false --roulette true --json "$rows"
    echo; echo "### seed1, 640x480, 64 samples, 64 levels, no direct light, no roulette"
    "$ENGINE_TIMES" --scene scenes/bansal-room-1.toml --size 640 480 --max-bounces 64 $plain --pool 8388608 --json "$rows"
    echo; echo "### The same at 8 levels"
    "$ENGINE_TIMES" --scene scenes/bansal-room-1.toml --size 640 480 --max-bounces 8 $plain --pool 8388608 --json "$rows"
    echo; echo "### Direct light with MIS, 64 levels, no roulette, 640x480, 64 samples"
    "$ENGINE_TIMES" --scene scenes/{bansal-room-1,bansal-room-5,cornell-box,door-ajar}.toml --size 640 480 \
      --max-bounces 64 --direct-light true --roulette false --json "$rows"
    echo; echo "### Every scene as it is shipped, stratified, 640x480, 64 samples"
    # A process per scene: NVIDIA's driver hands out no adapter any more after some 35 devices in one process.
    for scene in scenes/*.toml; do
      "$ENGINE_TIMES" --scene "$scene" --size 640 480 --stratified --repetitions 5 --json "$rows" | tail -n 4
    done
  } | tee "$OUT/times.md"
}

identity() {
  echo "| scene | fused | streamed | compacted | cpu: largest difference | cpu: pixels within 1e-3 |"
  echo "|---|---|---|---|---|---|"
  for scene in scenes/*.toml; do
    local name row; name=$(basename "$scene" .toml); row="| $name |"
    local common="--size 96x72 --spp 64 --seed 5 --no-features -q"
    "$QTRACER" render "$scene" $common --engine megakernel -o "$scratch/mega.exr" 2>/dev/null || row+=" megakernel failed"
    for schedule in fused streamed compacted; do
      "$QTRACER" render "$scene" $common --engine wavefront --schedule $schedule -o "$scratch/w.exr" 2>/dev/null
      row+=" $("$QTRACER" compare "$scratch/w.exr" "$scratch/mega.exr" --json | python3 -c 'import json,sys; print(json.load(sys.stdin)["differences"]["max_absolute"])') |"
    done
    "$QTRACER" render "$scene" $common --engine cpu -o "$scratch/c.exr" 2>/dev/null
    row+=$("$QTRACER" compare "$scratch/c.exr" "$scratch/mega.exr" --json | python3 -c 'import json,sys; d=json.load(sys.stdin)["differences"]; print(" %.3g | %.2f %% |" % (d["max_absolute"], 100*d["share_within_1e3"]))')
    echo "$row"
  done | tee "$OUT/identity.md"
}

references() {
  for pair in cornell-box:cornell bansal-room-1:seed1 bansal-room-5:seed5 door-ajar:door glass-caustic:caustic; do
    local reference="$REFERENCES/${pair#*:}.exr" size=256x256
    [[ $pair == bansal* ]] && size=320x240
    for engine in wavefront megakernel; do
      echo "## ${pair%:*} against ${pair#*:}, $engine, 65536 independent samples a pixel"
      "$QTRACER" render "scenes/${pair%:*}.toml" --engine $engine --size $size --spp 65536 --sampler independent \
        --direct-light on --roulette on --max-bounces 64 --no-features -o "$scratch/ours.exr" 2>&1 | grep wrote | sed 's/; wrote.*//'
      "$QTRACER" compare "$scratch/ours.exr" "$reference" --z-test 2>/dev/null; echo "exit $?"; echo
    done
  done | tee "$OUT/references.md"
}

for part in $parts; do $part; done
rm -rf "$scratch"
