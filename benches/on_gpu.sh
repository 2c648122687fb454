#!/usr/bin/env bash
# What docs/PERFORMANCE.md says of a GPU, in one session: times, identity of the engines, z-tests, growth with work, start-up.
#   cargo build --release && cargo bench --no-run --bench engine_times
#   QTRACER=target/release/qtracer ENGINE_TIMES=target/release/deps/engine_times-HASH \
#   REFERENCES=DIR_WITH_MITSUBA_EXR OUT=benches/results/DATE-DEVICE benches/on_gpu.sh [times|identity|references|growth|startup]…
set -u
: "${QTRACER:?}" "${ENGINE_TIMES:?}" "${OUT:?}"
parts=${*:-times identity references growth startup}
mkdir -p "$OUT"
scratch=$(mktemp -d)
"$QTRACER" info | tee "$OUT/device.txt"

# A value of --stats json.
stat() { python3 -c 'import json,sys; d=json.load(sys.stdin); print(*[d[k] if k != "buffers" else sum(d[k].values()) for k in sys.argv[1:]])' "$@"; }

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
    echo; echo "### Many materials, long paths: direct light, 64 levels, no roulette, 640x480, 64 samples"
    "$ENGINE_TIMES" --scene scenes/glass-shelf.toml --size 640 480 --max-bounces 64 --direct-light true --roulette false --json "$rows"
    echo; echo "### Meshes of seven materials: the same"
    "$ENGINE_TIMES" --scene scenes/{still-life,interior}.toml --size 640 480 --max-bounces 64 --direct-light true --roulette false \
      --repetitions 3 --json "$rows"
    echo; echo "### Every scene as it is shipped, stratified, 640x480, 64 samples; and what auto takes"
    for scene in scenes/*.toml; do
      "$ENGINE_TIMES" --scene "$scene" --size 640 480 --stratified --repetitions 5 --engines mega,fused --json "$rows" | tail -n 2
      echo "auto: $("$QTRACER" render "$scene" --size 64x48 --spp 1 -q --no-features --stats json -o "$scratch/auto.exr" 2>/dev/null | stat engine)"
    done
  } | tee "$OUT/times.md"
}

identity() {
  {
    echo "| scene | fused | sorted | streamed | compacted | cpu: largest difference | cpu: pixels within 1e-3 |"
    echo "|---|---|---|---|---|---|---|"
    for scene in scenes/*.toml; do
      local name row; name=$(basename "$scene" .toml); row="| $name |"
      local common="--size 96x72 --spp 64 --seed 5 --no-features -q"
      "$QTRACER" render "$scene" $common --engine megakernel -o "$scratch/mega.exr" 2>/dev/null || row+=" megakernel failed"
      for schedule in fused sorted streamed compacted; do
        "$QTRACER" render "$scene" $common --engine wavefront --schedule $schedule -o "$scratch/w.exr" 2>/dev/null
        row+=" $("$QTRACER" compare "$scratch/w.exr" "$scratch/mega.exr" --json 2>/dev/null | python3 -c 'import json,sys; print(json.load(sys.stdin)["differences"]["max_absolute"])') |"
      done
      "$QTRACER" render "$scene" $common --engine cpu -o "$scratch/c.exr" 2>/dev/null
      row+=$("$QTRACER" compare "$scratch/c.exr" "$scratch/mega.exr" --json 2>/dev/null | python3 -c 'import json,sys; d=json.load(sys.stdin)["differences"]; print(" %.3g | %.2f %% |" % (d["max_absolute"], 100*d["share_within_1e3"]))')
      echo "$row"
    done
  } | tee "$OUT/identity.md"
}

references() {
  for pair in cornell-box:cornell bansal-room-1:seed1 bansal-room-5:seed5 door-ajar:door glass-caustic:caustic; do
    local reference="$REFERENCES/${pair#*:}.exr" size=256x256
    [[ $pair == bansal* ]] && size=320x240
    for engine in wavefront megakernel; do
      echo "## ${pair%:*} against ${pair#*:}, $engine, 65536 independent samples a pixel"
      "$QTRACER" render "scenes/${pair%:*}.toml" --engine $engine --size $size --spp 65536 --sampler independent \
        --direct-light on --guide off --roulette throughput --max-bounces 64 --no-features -o "$scratch/ours.exr" 2>&1 | grep wrote | sed 's/; wrote.*//'
      "$QTRACER" compare "$scratch/ours.exr" "$reference" --z-test 2>/dev/null; echo "exit $?"; echo
    done
  done | tee "$OUT/references.md"
}

growth() { # time and memory against samples and pixels: medians, and how far a sample is from costing what one of 1024 does
  local rows="$OUT/growth.jsonl"; rm -f "$rows"
  row() { "$ENGINE_TIMES" --scene "scenes/$1.toml" --size $2 --spp "$3" --stratified --engines mega,fused --json "$rows" >/dev/null; }
  for scene in cornell-box bansal-room-5; do
    for spp in 16 64 256 1024; do row $scene "640 480" $spp; done
  done
  for size in "1280 960" "2560 1920" "3264 2448"; do row cornell-box "$size" 64; done
  python3 - "$rows" <<'END' | tee "$OUT/growth.md"
import json, statistics, sys
rows = [json.loads(line) for line in open(sys.argv[1])]
each = lambda row: 1e6 * statistics.median(row["gpu_ms"]) / row["paths"]
print("| scene | pixels | samples | engine | GPU ms | ns a sample | of 640x480x1024 | MiB of buffers |")
print("|---|---|---|---|---|---|---|---|")
for row in sorted(rows, key=lambda row: (row["scene"], row["engine"] == "fused")):
    most = next(r for r in rows if (r["scene"], r["engine"], r["spp"]) == (row["scene"], row["engine"], 1024))
    width, height = row["size"]
    print(f"| {row['scene']} | {width}x{height} | {row['spp']} | {row['engine']} | {statistics.median(row['gpu_ms']):.3f} | {each(row):.4f} "
          f"| {each(row) / each(most):.3f} | {sum(row['stats']['buffers'].values()) / 2**20:.1f} |")
END
}

startup() { # from the start of the process to ready kernels, and to the end of a render of one sample
  {
    echo "| scene | engine | kernels ready after, ms | process, ms |"; echo "|---|---|---|---|"
    for run in 1 2 3; do
      for pair in cornell-box:megakernel door-ajar:wavefront bansal-room-1:wavefront; do
        local begin end ready; begin=$(date +%s%N)
        ready=$("$QTRACER" render "scenes/${pair%:*}.toml" --spp 1 --engine "${pair#*:}" -q --no-features --stats json -o "$scratch/s.exr" 2>/dev/null | stat preparation_seconds)
        end=$(date +%s%N); echo "| ${pair%:*} | ${pair#*:} | $(python3 -c "print(round(1e3*$ready))") | $(((end - begin) / 1000000)) |"
      done
    done
  } | tee "$OUT/startup.md"
}

for part in $parts; do $part; done
rm -rf "$scratch"
