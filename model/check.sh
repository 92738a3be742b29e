#!/bin/sh
# Runs spin over link.pml: the link as it is must have no error, each seeded bug must be found. Needs spin and a C compiler.
set -eu
here=$(cd "$(dirname "$0")" && pwd)
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
command -v spin >/dev/null || { echo "model: spin is not installed (Debian: apt-get install spin)" >&2; exit 2; }
failed=0

run() { # name, expected number of errors (0 or 1), spin options
	name=$1; expected=$2; shift 2
	( cd "$work" && cp "$here/link.pml" . && spin -a "$@" link.pml >/dev/null &&
	  cc -O2 -w -DSAFETY -DCOLLAPSE -DMEMLIM=3000 -o pan pan.c && ./pan -m200000 -w24 >pan.out 2>&1 || true )
	errors=$(sed -n 's/.*errors: \([0-9]*\).*/\1/p' "$work/pan.out" | head -1)
	states=$(sed -n 's/ *\([0-9.e+]*\) states, stored.*/\1/p' "$work/pan.out" | head -1)
	seconds=$(sed -n 's/pan: elapsed time \([0-9.]*\) seconds/\1/p' "$work/pan.out" | head -1)
	complete=yes
	grep -q "max search depth too small\|out of memory\|reached -DMEMLIM" "$work/pan.out" && complete=no
	verdict=ok
	[ "${errors:-none}" = "$expected" ] || verdict=FAILED
	[ "$expected" = 0 ] && [ "$complete" = no ] && verdict=FAILED
	[ "$expected" = 1 ] && ! grep -q "assertion violated" "$work/pan.out" && verdict=FAILED
	[ "$verdict" = ok ] || { failed=1; tail -40 "$work/pan.out"; }
	printf '%-44s errors %-5s expected %-2s states %-12s %6s s  %s\n' "$name" "${errors:-none}" "$expected" "$states" "$seconds" "$verdict"
}

run "the link as it is, window 3 of 4" 0
run "window 2, two restarts" 0 -DW=2 -DRESTARTS=2 -DOWN_STOPS=0 -DN=3
run "two stops" 0 -DW=2 -DSTOPS=2 -DRESTARTS=0 -DN=3
run "bug: no epoch" 1 -DNO_EPOCH
run "bug: window as large as the sequence space" 1 -DW=4
run "bug: no stop generation" 1 -DNO_GENERATION
[ "$failed" = 0 ] && echo "model: ok" || { echo "model: FAILED"; exit 1; }
