#!/bin/sh
# Copies the data folder of a service into a new folder named after the time: back-up.sh DATA BACKUPS
# The service may run. Jobs come first, then the journal, then the segments, so that the copy has every result that a copied
# job lists as done. Settings are not copied: back up /etc/ricochet.env yourself.
set -eu
umask 077
data=$1
copy=$2/$(date -u +%Y-%m-%dT%H%M%SZ)
mkdir -p "$copy/results"

for name in jobs auth results/journal; do
    [ -e "$data/$name.sqlite" ] || continue # there is no auth.sqlite without keys
    python -c 'import sqlite3, sys; sqlite3.connect(sys.argv[1]).execute("VACUUM INTO ?", sys.argv[2:])' \
        "$data/$name.sqlite" "$copy/$name.sqlite"
done
# With this file but without auth.sqlite the service refuses to start; without both it would serve everybody.
[ ! -e "$data/auth.lock" ] || cp "$data/auth.lock" "$copy/"
# cp fails if the service removes a segment in the meantime; the second attempt distinguishes that from a full disk.
if [ -d "$data/results/segments" ]; then
    cp -pR "$data/results/segments" "$copy/results/" || cp -pR "$data/results/segments" "$copy/results/"
fi
echo "$copy"
