#!/bin/sh
# Opens a report in a headless browser as a phone, a desktop and a sheet of A4 would show it. Fails on anything in the
# browser's console, on any request, on a page wider than the screen, on tables whose columns are cut off on the phone or on
# paper, and above 5 MB. Leaves pictures of the whole page.
#
#   tools/report/check.sh [REPORT.html [FOLDER-FOR-PICTURES]]
#
# Without a report, calibrates the recording in fixtures/board first, checks that the desktop page is at most 6950 px high before a
# section is opened, and checks the pages of evcal live (check-live.py) and of evcal board (check-blinking.py), too. Installs Debian's chromium-headless-shell (99 MB)
# where there is no such browser.
set -eu
cd "$(dirname "$0")/../.."
script=test-report
. tools/setup/packages.sh
target="${CARGO_TARGET_DIR:-target}"
pictures="${2:-$target/report}"
largest=5000000
highest=6950
mkdir -p "$pictures"

find_browser() {
    for name in chromium-headless-shell chrome-headless-shell; do
        if command -v "$name" >/dev/null 2>&1; then
            echo "$name"
            return
        fi
    done
}

browser=$(find_browser)
if [ -z "$browser" ]; then
    if ! is_debian; then
        echo "test-report: no chromium-headless-shell here and no apt-get to install it: the report is not looked at"
        exit 0
    fi
    if ! install_packages chromium-headless-shell fonts-dejavu-core 2>"$pictures/install.log"; then
        tail -n 5 "$pictures/install.log"
        echo "test-report: this system has no package chromium-headless-shell: the report is not looked at"
        exit 0
    fi
    browser=$(find_browser)
fi

report="${1:-}"
only_report="$report"
if [ -z "$report" ]; then
    rm -rf "$pictures/calibration"
    "$target/release/evcal" calibrate fixtures/board/events.dvraw --board acircles:9x4:55mm:r17.5mm \
        -o "$pictures/calibration" >"$pictures/calibrate.log"
    report="$pictures/calibration/report.html"
fi
failed=0
fail() {
    echo "test-report: $*"
    failed=1
}

bytes=$(wc -c <"$report")
[ "$bytes" -le "$largest" ] || fail "$report has $bytes bytes, more than $largest"

folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cp "$report" "$folder/report.html"
# A copy whose title contains its size, and the tables that are wider than their place after everything folded was opened. The report
# itself allows no script.
cat >"$folder/script" <<'END'
<script>
const root = document.documentElement;
const size = [root.scrollWidth, root.clientWidth, root.scrollHeight].join(" ");
document.querySelectorAll("details").forEach(part => part.open = true);
const wide = [...document.querySelectorAll(".scroll")].filter(part => part.scrollWidth > part.clientWidth);
const cut = wide.map(part => `${part.getAttribute("aria-label")} (${part.scrollWidth} px of ${part.clientWidth})`);
document.title = `size ${size} cut ${cut.join(", ")} end`;
</script>
END
sed -e 's|<meta http-equiv="Content-Security-Policy"[^>]*>||' -e "/<\/body>/r $folder/script" "$report" >"$folder/measured.html"
# The same as printed: A4 is 680 px wide between its margins.
sed -e 's|@media print|@media all|' "$folder/measured.html" >"$folder/printed.html"

# browse WIDTH HEIGHT FILE OPTION...: opens FILE; the browser's messages go to standard error.
browse() {
    width=$1 height=$2 file=$3
    shift 3
    timeout 120 "$browser" --no-sandbox --disable-gpu --hide-scrollbars --user-data-dir="$folder/profile" \
        --window-size="$width,$height" --enable-logging=stderr --log-net-log="$folder/net.json" "$@" \
        "file://$folder/$file"
}

# cut_in FILE: prints the tables that are cut off in a page dumped by the browser.
cut_in() {
    sed -n 's|.*<title>size [0-9 ]* cut \(.*\) end</title>.*|\1|p' "$1" | head -n 1
}

browse 680 960 printed.html --dump-dom >"$folder/dom.html" 2>"$folder/log"
grep -q '<title>size ' "$folder/dom.html" || fail "the browser did not report the size of the printed page"
cut=$(cut_in "$folder/dom.html")
[ -z "$cut" ] || fail "on paper these tables are cut: $cut"

for size in "390 844 phone" "1440 900 desktop"; do
    # shellcheck disable=SC2086 # three words
    set -- $size
    width=$1 height=$2 name=$3
    browse "$width" "$height" measured.html --dump-dom >"$folder/dom.html" 2>"$folder/log"
    measured=$(sed -n 's|.*<title>size \([0-9 ]*\) cut .*|\1|p' "$folder/dom.html" | head -n 1)
    cut=$(cut_in "$folder/dom.html")
    [ -z "$cut" ] || fail "at $width px these tables are cut: $cut"
    # shellcheck disable=SC2086 # three numbers
    set -- $measured
    if [ $# -ne 3 ]; then
        fail "the browser did not report the size of the page: $(tail -n 3 "$folder/log")"
        continue
    fi
    [ "$1" -le "$2" ] || fail "at $width px the page is $1 px wide"
    page_height=$3
    if [ -z "$only_report" ] && [ "$name" = desktop ] && [ "$page_height" -gt "$highest" ]; then
        fail "at $width px the page is $page_height px high, more than $highest"
    fi
    browse "$width" "$page_height" report.html --screenshot="$pictures/report-$name.png" 2>"$folder/log"
    if grep 'CONSOLE' "$folder/log"; then
        fail "at $width px the browser's console is not empty"
    fi
    if grep -o '"url":"[a-z]*://[^"]*"' "$folder/net.json" | grep -v '"url":"file://'; then
        fail "at $width px the browser asked for something outside of the file"
    fi
    [ -s "$pictures/report-$name.png" ] || fail "no picture at $width px"
    echo "test-report: $name: page of $2 x $page_height px, $pictures/report-$name.png"
done
[ "$failed" -eq 0 ] || exit 1
echo "test-report: $report: $bytes bytes, no request, nothing in the console, no overflow"
[ -z "$only_report" ] || exit 0
if command -v python3 >/dev/null 2>&1; then
    python3 -B tools/report/check-live.py "$target/release/evcal" "$browser" "$pictures"
    python3 -B tools/report/check-blinking.py "$target/release/evcal" "$browser" "$pictures"
else
    echo "test-report: no python3 here: the page of evcal live is not looked at"
fi
