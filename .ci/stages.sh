# What .ci/quick, run and long share; they source it. `stage NAME COMMAND ..` runs the command and notes its time; at
# the end, whichever it is, the times of all stages are printed.
cd "$(dirname "${BASH_SOURCE[0]}")/.."
export CARGO_INCREMENTAL=0 RUSTDOCFLAGS="-D warnings"
stage_times=()

stage() {
  local name=$1 begun=$EPOCHREALTIME
  shift
  echo "== $name"
  running=$name
  "$@"
  stage_times+=("$(awk -v a="$begun" -v b="$EPOCHREALTIME" 'BEGIN { printf "%7.1f s", b - a }')  $name")
  running=
}

print_times() {
  local ended=$?
  [[ -z "${running:-}" ]] || stage_times+=("  ended at  $running")
  printf '%s\n' "== times" "${stage_times[@]}" "$(awk "BEGIN { printf \"%5.1f min  in all\", $SECONDS / 60 }")"
  return $ended
}
trap print_times EXIT
