#!/bin/sh
# A private PostgreSQL server in a folder, reachable only by a socket in that folder.
#
#   scripts/postgres.sh install       install PostgreSQL where it is missing (apt, as root or by sudo)
#   scripts/postgres.sh start DIR     make and start a server in the empty folder DIR; prints its URL
#   scripts/postgres.sh stop DIR      stop it
set -eu

usage() { sed -n '2,/^set -eu/p' "$0" | sed -n 's/^# \{0,1\}//p' >&2; exit 2; }
bin() {
    for found in $(ls /usr/lib/postgresql/*/bin/createdb 2>/dev/null || true) $(command -v createdb || true); do
        dirname "$found"
        return
    done
    echo "postgres: no server is installed: run scripts/postgres.sh install" >&2
    exit 3
}
# A server refuses to run as root: it then runs as the user postgres.
as_user() {
    if [ "$(id -u)" = 0 ]; then (cd / && runuser -u postgres -- "$@"); else "$@"; fi
}

[ $# -ge 1 ] || usage
case $1 in
    install)
        if ls /usr/lib/postgresql/*/bin/initdb >/dev/null 2>&1; then exit 0; fi
        sudo=$(test "$(id -u)" = 0 || echo sudo)
        $sudo apt-get update -q
        # No cluster of the system's: only the programs are wanted.
        $sudo mkdir -p /etc/postgresql-common
        grep -qs create_main_cluster /etc/postgresql-common/createcluster.conf ||
            echo "create_main_cluster = false" | $sudo tee -a /etc/postgresql-common/createcluster.conf >/dev/null
        $sudo env DEBIAN_FRONTEND=noninteractive apt-get install -q -y --no-install-recommends postgresql
        ;;
    start)
        [ $# = 2 ] || usage
        programs=$(bin)
        [ "$(id -u)" != 0 ] || chown postgres "$2"
        chmod 700 "$2"
        as_user "$programs/initdb" --pgdata "$2/data" --username robots --auth trust --no-sync >"$2/initdb.log"
        as_user "$programs/pg_ctl" --pgdata "$2/data" --log "$2/server.log" --wait \
            --options "-c listen_addresses='' -c unix_socket_directories='$2'" start >/dev/null
        as_user "$programs/createdb" --host "$2" --username robots fleet
        echo "postgres://robots@localhost/fleet?host=$2"
        ;;
    stop)
        [ $# = 2 ] || usage
        as_user "$(bin)/pg_ctl" --pgdata "$2/data" --mode fast --wait stop >/dev/null
        ;;
    *) usage ;;
esac
