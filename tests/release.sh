#!/bin/bash
# What pip installs: wheel and source archive, with each set of optional parts, on each Python, tried in another folder.
# Usage: release.sh UV CONSTRAINTS DIST PYTHON..., with PARTS for some of the optional parts alone
set -euo pipefail
uv=$(realpath "$1") constraints=$(realpath "$2") dist=$(realpath "$3")
shift 3
home=$(mktemp -d)
trap 'rm -rf "$home"' EXIT
export MECHSEARCH_CACHE="$home/cache" PYTHONPATH=

# Says what is being tried; shows what it printed only if it fails.
try() {
	if ! "$@" >"$home/said" 2>&1; then
		echo "failed: $*"
		cat "$home/said"
		exit 1
	fi
}

base() {
	try mechsearch doctor
	try mechsearch heaps show household-single --out heaps.png
	try mechsearch evaluate teacher-spiral --limit 1 --workers 2 --brief
	try mechsearch show evaluations/teacher-spiral.npz --size 64 --out episode.gif
	try mechsearch export episodes evaluations/teacher-spiral.npz --format minari --out data --workers 1
	# What is not installed is named, with what to install.
	if mechsearch report evaluations 2>"$home/said"; then exit 1; fi
	grep -q "pip install '.\[report\]'" "$home/said"
}

learn() {
	try mechsearch evaluate uncover --limit 1 --workers 1 --brief
	try mechsearch train debug --heaps household-single --actions 40 --validation-heaps 1 --out run
}

all() {
	try mechsearch doctor
	learn
	try mechsearch show evaluations/uncover-*.npz --size 64 --out episode.mp4
	try mechsearch report evaluations run --out report.html --pdf report.pdf
	printf 'v -%s 0 0\nv %s 0 0\nv 0 .05 0\nv 0 0 .04\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n' .05 .05 >wedge.obj
	mkdir -p toys && mv wedge.obj toys && printf 'object,mass_kg\nwedge,0.05\n' >toys/masses.csv
	try mechsearch objects list --objects toys
}

robot() {
	try mechsearch doctor
}

version=$(sed -n 's/^version = "\(.*\)"/\1/p' pyproject.toml)
for said in "CITATION.cff:version: $version" "CHANGELOG.md:## \[$version\]"; do
	grep -q "^${said#*:}" "${said%%:*}" || { echo "failed: no version $version in ${said%%:*}"; exit 1; }
done

for extra in ${PARTS:-base learn $(grep -o "^robot = " pyproject.toml | cut -d" " -f1) all}; do
	for python in "$@"; do
		for file in "$dist"/*.whl "$dist"/*.tar.gz; do
			# An archive builds the same wheel, and all parts together are each part: once is enough.
			if [[ $python != "$1" && ($extra == all || $file == *.gz) ]]; then continue; fi
			if [[ $extra != base && $file == *.gz ]]; then continue; fi
			rm -rf "$home/tried" "$home/venv" && mkdir "$home/tried"
			"$uv" venv --quiet --python "$python" "$home/venv"
			"$uv" pip install --quiet --python "$home/venv/bin/python" --constraints "$constraints" \
				"$file$([[ $extra == base ]] || echo "[$extra]")"
			size=$(du -sm --apparent-size "$home/venv" | cut -f1)
			if [[ $extra == base && $size -gt 450 ]]; then
				echo "failed: the base install has $size MB; expected at most 450"
				exit 1
			fi
			(cd "$home/tried" && PATH="$home/venv/bin:$PATH" && $extra)
			echo "$("$python" --version) ${file##*.} $extra: works, $size MB"
		done
	done
done

# What a robot's computer installs: under 400 MB, and ready to decide in under 2 s of a processor.
try "$uv" venv --quiet --clear --python "$1" "$home/venv"
size=$(du -sb "$home/venv" | cut -f1)
try "$uv" pip install --quiet --python "$home/venv/bin/python" --constraints "$constraints" "$dist"/robot/*.whl
size=$((($(du -sb "$home/venv" | cut -f1) - size) / 1000000))
((size < 400)) || { echo "failed: $size MB" && exit 1; }
mkdir -p "$home/tried" && cd "$home/tried"
try "$home/venv/bin/mechsearch" robot play --help
cat >starts.py <<END
import time
import numpy as np
from mechsearch.robot.controller import Controller
from mechsearch.robot.policy import open_policy
policy = open_policy("$dist/robot/uncover")
side = policy.camera.height
seen = np.zeros((3, side, side), np.float16)
seen[:, 30:34, 30:34] = 0.01
obs = {"depth": np.ones((1, side, side), np.float16), "position_image": seen}
policy.choose(obs | {"ee_position": np.array([0.2, 0.0, 0.1], np.float32)})
assert time.process_time() < 2, f"{time.process_time():.1f} s"
END
try "$home/venv/bin/python" starts.py
echo "$("$1" --version) whl for a robot: works, $size MB"
