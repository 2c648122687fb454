#!/usr/bin/env bash
# What docs/ACCURACY.md claims about whole images at full size, in one session: every engine and guide against converged
# images by another renderer, each with as many samples as some seconds on a GPU buy.
#   cargo build --release
#   QTRACER=target/release/qtracer REFERENCES=DIR_WITH_MITSUBA_EXR MITSUBA=python3 OUT=benches/results/DATE-DEVICE \
#   benches/accuracy_on_gpu.sh [tight|images]…
# `tight` makes references into OUT: of the three scenes where Mitsuba's own tolerances show, and of the caustic, whose light is
# too rare for 32,768 samples; `images` prefers those. SCENES, ROWS: only
# these (a list; a pattern).
set -u
: "${QTRACER:?}" "${REFERENCES:?}" "${OUT:?}"
parts=${*:-tight images}
variant=${VARIANT:-cuda_ad_rgb}
# Divides all numbers of samples, to try the script.
less=${LESS:-1}
mkdir -p "$OUT"
scratch=$(mktemp -d)
"$QTRACER" info > "$OUT/device.txt"

wanted() { [[ " ${SCENES:-$1} " == *" $1 "* ]]; }

tight() {
  local peer="${MITSUBA:-python3} benches/peers/mitsuba_reference.py --variant $variant"
  wanted cornell-box && $peer scenes/cornell-box.toml --size 256 256 --spp $((65536 / less)) --offset 2e-6 --out "$OUT/cornell.exr"
  # The rooms' walls are spheres of radius 2000, which need the wider offset.
  wanted bansal-room-1 && $peer scenes/bansal-room-1.toml --size 320 240 --spp $((32768 / less)) --out "$OUT/seed1.exr"
  wanted mesh && $peer scenes/mesh.toml --size 256 256 --spp $((65536 / less)) --offset 2e-6 --out "$OUT/mesh.exr"
  wanted glass-caustic && $peer scenes/glass-caustic.toml --size 256 256 --spp $((524288 / less)) --offset 2e-6 --out "$OUT/caustic.exr"
}

# Renders SCENE SIZE SAMPLES FILE OPTION… and prints the seconds that it took.
image() {
  local scene=$1 size=$2 spp=$3 file=$4; shift 4
  "$QTRACER" render "scenes/$scene.toml" --size "$size" --spp "$spp" --sampler independent --direct-light on \
    --max-bounces 64 --no-features -q --stats json -o "$file" "$@" 2> "$scratch/log" |
    python3 -c 'import json,sys; print("%.1f" % json.load(sys.stdin)["seconds"])'
}

# What the z-test says of $scratch/ours.exr against FILE, as a row: FILE SCENE NAME SAMPLES SECONDS.
verdict() {
  local file=$1; shift
  "$QTRACER" compare "$scratch/ours.exr" "$file" --z-test --json 2>/dev/null | python3 -c '
import json, sys
found, (scene, name, spp, seconds) = json.load(sys.stdin), sys.argv[1:]
test, ratio = found["z_test"], found["mean_ratio"]
blocks, means = test["blocks"], test["means"]
error = abs(ratio[means["channel"]] - 1) / max(means["max_abs_z"], 1e-9)
verdict = "pass" if test["passes"] else "FAIL"
print("|", " | ".join([scene, name, spp, seconds, " ".join("%.5f" % r for r in ratio), "%.1e" % error,
    "%.2f (%.2f)" % (blocks["max_abs_z"], blocks["threshold"]), "%.2f" % means["max_abs_z"], verdict]), "|")
' "$@"
}

samples() { echo $(($1 / less < 4 ? 4 : $1 / less)); }

# One row: SCENE REFERENCE SIZE SAMPLES NAME OPTION…
row() {
  local scene=$1 reference=$2 size=$3 spp=$(samples "$4") name=$5; shift 5
  # shellcheck disable=SC2053
  [[ $name == ${ROWS:-*} ]] || return
  local file="$REFERENCES/$reference.exr" mark=""
  [ -f "$OUT/$reference.exr" ] && file="$OUT/$reference.exr" mark=" (tight)"
  local seconds; seconds=$(image "$scene" "$size" "$spp" "$scratch/ours.exr" "$@") ||
    { echo "| $scene | $name | $(tail -1 "$scratch/log") |"; return; }
  verdict "$file" "$scene$mark" "$name" "$spp" "$seconds"
}

# The CPU against the megakernel, which draw the same numbers for the same paths: light that is rare is as rare in both.
paired() {
  local scene=$1 size=$3 spp=$(samples "$4")
  # shellcheck disable=SC2053
  [[ paired == ${ROWS:-*} ]] || return
  local seconds; seconds=$(image "$scene" "$size" "$spp" "$scratch/ours.exr" --engine cpu --roulette throughput --seed 7)
  image "$scene" "$size" "$spp" "$scratch/theirs.exr" --engine megakernel --roulette throughput --seed 7 > /dev/null
  verdict "$scratch/theirs.exr" "$scene" "cpu against megakernel, same paths" "$spp" "$seconds"
}

images() {
  echo "| scene | engine, guide, roulette | samples | seconds | mean ratio R G B | s.e. of it | max \\|z\\| of blocks (limit) | of means (3.14) | |"
  echo "|---|---|---|---|---|---|---|---|---|"
  for pair in cornell-box:cornell bansal-room-1:seed1 bansal-room-5:seed5 door-ajar:door glass-caustic:caustic mesh:mesh; do
    wanted "${pair%:*}" || continue
    local at="${pair%:*} ${pair#*:} 256x256" plain=262144 guided=65536 cpu=1024
    case $pair in
      bansal*) at="${pair%:*} ${pair#*:} 320x240" ;;
      # Rarer light: from fewer samples standard errors are not known.
      door*) cpu=8192 ;;
      glass*) plain=1048576 guided=1048576 cpu=16384 ;;
    esac
    row $at $plain "wavefront" --engine wavefront --roulette throughput
    row $at $plain "megakernel" --engine megakernel --roulette throughput
    row $at $((plain / 16)) "wavefront, no roulette" --engine wavefront --roulette off
    row $at $cpu "cpu" --engine cpu --roulette throughput
    paired $at $cpu
    row $at $guided "adaptive, learnt" --guide adaptive --roulette learnt
    row $at $guided "adaptive" --guide adaptive --roulette throughput
    row $at $guided "octant" --guide octant --roulette throughput
    row $at $guided "octant, learnt" --guide octant --roulette learnt
    row $at $((guided / 4)) "bansal-reweighted" --guide bansal-reweighted --roulette throughput
    row $at 1024 "bansal (biased: must fail)" --guide bansal --roulette throughput
  done
}

for part in $parts; do
  case $part in
    tight | images) $part | tee "$OUT/$part.md" ;;
    *) echo "no part $part; there are tight and images" >&2; exit 2 ;;
  esac
done
rm -rf "$scratch"
