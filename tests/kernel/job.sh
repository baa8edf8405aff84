# Sourced by uml.sh and guest.sh: reads their arguments, writes what the guest is to do into
# $job, and defines `run`.
export PATH=$PATH:/usr/sbin:/sbin
modules='' seconds=300
while [ $# -gt 0 ]; do
    case $1 in
    --modules) modules=$2; shift 2 ;;
    --seconds) seconds=$2; shift 2 ;;
    --) shift; break ;;
    *) echo "unknown option $1" >&2; exit 2 ;;
    esac
done
kernels=${TACTILE_KERNELS:-${XDG_CACHE_HOME:-$HOME/.cache}/tactile/kernels}
if [ ! -e "$kernels/complete" ]; then
    echo "no kernels in $kernels: kernels.sh fetches them" >&2
    exit 2
fi
kernels=$(cd "$kernels" && pwd)
job=$(mktemp -d)
guest=''
clean_up() {
    [ -z "$guest" ] || { kill "$guest" && wait "$guest"; } 2>/dev/null || true
    rm -rf "$job"
}
trap clean_up EXIT
trap 'exit 143' TERM INT HUP

{
    export -p
    printf 'modules=%q\ncd %q\ncommand=(' "$modules" "$PWD"
    printf ' %q' "$@"
    echo ' )'
} >"$job/command"

exec 9>&2

# Start the guest, wait for its end and return the exit code of the command in it.
run() {
    timeout --kill-after=5 "$seconds" "$@" </dev/null 9>&- &
    guest=$!
    wait "$guest" || true
    guest=''
    [ -s "$job/status" ] && exit "$(tr -d '\r\n' <"$job/status")"
    {
        echo "the guest gave no exit code in $seconds s; the last of its console:"
        tail -n 20 "$job/console"
    } >&9
    exit 125
}
