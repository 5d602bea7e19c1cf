#!/bin/sh
# Copies the data folder of a service into a new folder named after the time: back-up.sh DATA BACKUPS
# The service may run. Jobs come first, then the journal, then the segments: every result that the copied jobs call done
# is then in the copy. Settings are not copied; /etc/ricochet.env is yours to keep.
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
# With this file and without auth.sqlite the service refuses to start, rather than let everybody in.
[ ! -e "$data/auth.lock" ] || cp "$data/auth.lock" "$copy/"
# cp fails if the service removes a segment meanwhile; the second attempt tells that from a disk that is full.
if [ -d "$data/results/segments" ]; then
    cp -pR "$data/results/segments" "$copy/results/" || cp -pR "$data/results/segments" "$copy/results/"
fi
echo "$copy"
