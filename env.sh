# The environment of this project:   . ./env.sh   (bash; zsh should do, it has not been tried)
# Discovery stays on this machine unless ROS_AUTOMATIC_DISCOVERY_RANGE says otherwise.
_np_root=$(cd "$(dirname "${BASH_SOURCE[0]:-$0}")" && pwd)

if [ ! -f "$_np_root/.venv/bin/activate" ]; then
    echo "env.sh: expected an environment in $_np_root/.venv, found none: run \`make setup\` there first" >&2
    unset _np_root
    return 1
fi

# Called from another environment of ROS wheels (they set this in every child): its libraries must not be found first.
if [ -n "${_ROS_WHEELS_BOOTSTRAP_COMPLETE:-}" ]; then
    unset _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH
fi

. "$_np_root/.venv/bin/activate"
# Byte code that shall not lie beside its sources (many containers say so) lies in .venv: without any, every process of a
# graph would compile all that it imports, which doubles its start.
if [ -n "${PYTHONDONTWRITEBYTECODE:-}" ]; then
    unset PYTHONDONTWRITEBYTECODE
    export PYTHONPYCACHEPREFIX="${PYTHONPYCACHEPREFIX:-$VIRTUAL_ENV/byte_code}"
fi
case ":${AMENT_PREFIX_PATH:-}:" in
    *":$VIRTUAL_ENV:"*) ;;
    *) export AMENT_PREFIX_PATH="$VIRTUAL_ENV${AMENT_PREFIX_PATH:+:$AMENT_PREFIX_PATH}" ;;
esac
if [ -f "$_np_root/ros2_ws/install/local_setup.bash" ]; then
    . "$_np_root/ros2_ws/install/local_setup.${ZSH_VERSION:+z}${BASH_VERSION:+ba}sh"
fi
case ":${PYTHONPATH:-}:" in
    *":$_np_root/training:"*) ;;
    *) export PYTHONPATH="$_np_root/training:$_np_root/benchmark${PYTHONPATH:+:$PYTHONPATH}" ;;
esac
# Tab after `ros2`, in a shell that somebody types in; a whole ROS 2 brings its own.
_np_complete_ros2() {
    local IFS=$'\n'
    COMPREPLY=($(COMP_LINE="$COMP_LINE" COMP_POINT="$COMP_POINT" ros2 --complete 2> /dev/null))
    case "${COMPREPLY[0]:-}" in *:=) compopt -o nospace 2> /dev/null ;; esac
}
case "$-:${ROS_DISTRO:-}" in *i*:)
    [ -z "${ZSH_VERSION:-}" ] || { autoload -U +X bashcompinit && bashcompinit; }
    complete -o default -F _np_complete_ros2 ros2 ;;
esac
export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}"
_np_profile="$_np_root/ros2_ws/src/np_ros/np_ros/data/fastdds.xml"
export FASTRTPS_DEFAULT_PROFILES_FILE="${FASTRTPS_DEFAULT_PROFILES_FILE:-$_np_profile}"
unset _np_root _np_profile
