"""URScript statements that cannot move points or frames, with the reason."""

from __future__ import annotations

from machopt.programs.reading.harmless_word_reasons import CHECKS, LOAD, OUTPUT, TEXT

URSCRIPT: dict[str, str] = {
    **dict.fromkeys(("set_gravity", "set_payload", "set_target_payload"), LOAD),
    **dict.fromkeys(("set_safety_mode", "protect"), CHECKS),
    **dict.fromkeys(
        (
            "set_tool_voltage",
            "set_analog",
            "set_configurable",
            "write_port",
            "set_standard",
            "set_tool",
            "set_runstate",
            "set_input_actions",
        ),
        OUTPUT,
    ),
    "set_conveyor": "tick counts of a conveyor; following one is refused",
    **dict.fromkeys(("textmsg", "socket_", "modbus", "rtde", "popup"), TEXT),
    **dict.fromkeys(
        ("stopj", "stopl", "sync", "enter_critical", "exit_critical", "return"), "when the robot moves, not where"
    ),
    **dict.fromkeys(
        ("zero_ftsensor", "end_force_mode", "enable_external_ft_sensor"),
        "the force sensor, and force control off; it is refused when it begins",
    ),
}
