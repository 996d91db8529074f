# Sourced by demo.sh and nodes.sh: keeps account of the processes that a script starts, and ends them.
# shellcheck shell=bash
pids=()

any_alive() {
    local pid
    for pid in "${pids[@]}"; do
        if kill -0 "$pid" 2>/dev/null; then return 0; fi
    done
    return 1
}

signal_all() { # SIGNAL
    local pid
    for pid in "${pids[@]}"; do kill "-$1" "$pid" 2>/dev/null || true; done
}

# Ends what was started; what does not end by itself within ten seconds is ended.
stop_all() {
    trap '' INT TERM HUP
    trap - EXIT
    signal_all TERM
    local tenths=100
    while any_alive && [ $tenths -gt 0 ]; do
        sleep 0.1
        tenths=$((tenths - 1))
    done
    signal_all KILL
    wait
}

on_signal() { # NAME STATUS
    stop_all
    echo "$(basename "$0"): stopped by SIG$1; nothing it started is left running." >&2
    exit "$2"
}

# From here on nothing that is in pids outlives the script.
stop_at_exit() {
    trap stop_all EXIT
    trap 'on_signal INT 130' INT
    trap 'on_signal TERM 143' TERM
    trap 'on_signal HUP 129' HUP
}
