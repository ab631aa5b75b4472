# SPDX-License-Identifier: Apache-2.0
"""The policy of a robot's navigation and manipulation: one enclave for a dozen nodes, with every name that they use.

The names are the defaults of Nav2 and MoveIt. They are words, not numbers, as in a document for a real robot. Every
node has its parameters, its life cycle and its own topics; servers and clients of the actions share the enclave.
"""

from __future__ import annotations

from collections.abc import Iterator

SUBJECT = "/navigation"
NODES = (
    "amcl", "map_server", "controller_server", "planner_server", "behavior_server", "bt_navigator", "smoother_server",
    "waypoint_follower", "velocity_smoother", "collision_monitor", "local_costmap/local_costmap",
    "global_costmap/global_costmap", "move_group", "robot_state_publisher",
)  # fmt: skip
LIFECYCLE = ("change_state", "get_state", "get_available_states", "get_available_transitions", "get_transition_graph")
ACTIONS = (
    "navigate_to_pose", "navigate_through_poses", "compute_path_to_pose", "compute_path_through_poses", "follow_path",
    "spin", "backup", "drive_on_heading", "wait", "assisted_teleop", "smooth_path", "follow_waypoints",
    "follow_gps_waypoints", "move_action", "execute_trajectory", "sequence_move_group",
    "arm_controller/follow_joint_trajectory", "gripper_controller/gripper_cmd",
)  # fmt: skip
SERVICES = (
    "map_server/load_map", "map_server/map", "map_saver/save_map", "reinitialize_global_localization",
    "request_nomotion_update", "set_initial_pose", "is_path_valid", "lifecycle_manager_navigation/manage_nodes",
    "lifecycle_manager_navigation/is_active", "lifecycle_manager_localization/manage_nodes",
    "lifecycle_manager_localization/is_active", "local_costmap/clear_entirely_local_costmap",
    "local_costmap/clear_around_local_costmap", "local_costmap/clear_except_local_costmap", "local_costmap/get_costmap",
    "global_costmap/clear_entirely_global_costmap", "global_costmap/clear_around_global_costmap",
    "global_costmap/clear_except_global_costmap", "global_costmap/get_costmap", "apply_planning_scene",
    "get_planning_scene", "check_state_validity", "compute_cartesian_path", "compute_fk", "compute_ik",
    "plan_kinematic_path", "query_planner_interface", "get_planner_params", "set_planner_params", "clear_octomap",
    "save_map", "load_map", "get_urdf", "save_geometry_to_file", "load_geometry_from_file",
)  # fmt: skip
TOPICS = (
    "scan", "odom", "imu/data", "cmd_vel", "cmd_vel_nav", "cmd_vel_smoothed", "cmd_vel_teleop", "tf", "tf_static",
    "map", "map_updates", "amcl_pose", "initialpose", "particle_cloud", "goal_pose", "plan", "plan_smoothed",
    "local_plan", "received_global_plan", "transformed_global_plan", "unsmoothed_plan", "lookahead_point",
    "lookahead_collision_arc", "evaluation", "marker", "cost_cloud", "speed_limit", "preempt_teleop", "bond",
    "diagnostics", "behavior_tree_log", "waypoints", "robot_description", "joint_states", "dynamic_joint_states",
    "collision_monitor_state", "polygon_stop", "polygon_slowdown", "polygon_approach", "local_costmap/costmap",
    "local_costmap/costmap_raw", "local_costmap/costmap_updates", "local_costmap/published_footprint",
    "local_costmap/footprint", "local_costmap/voxel_grid", "local_costmap/clearing_endpoints",
    "global_costmap/costmap", "global_costmap/costmap_raw", "global_costmap/costmap_updates",
    "global_costmap/published_footprint", "global_costmap/footprint", "global_costmap/voxel_grid",
    "camera/color/image_raw", "camera/color/camera_info", "camera/depth/image_rect_raw", "camera/depth/points",
    "camera/depth/camera_info", "camera/infra/image_raw", "monitored_planning_scene", "planning_scene",
    "planning_scene_world", "attached_collision_object", "collision_object", "display_planned_path",
    "display_contacts", "motion_plan_request", "recognized_object_array", "trajectory_execution_event",
    "arm_controller/joint_trajectory", "arm_controller/controller_state", "arm_controller/state",
    "gripper_controller/controller_state", "robot_description_semantic", "battery_state", "wheel_odometry",
    "sonar/front", "sonar/rear", "bumper/left", "bumper/right", "cliff/front_left", "cliff/front_right",
    "lidar/points", "lidar/intensity", "gps/fix", "gps/velocity", "odometry/filtered", "odometry/gps", "mode/manual",
    "mode/autonomous", "charging_dock/pose", "keepout_filter_mask", "costmap_filter_info", "speed_filter_mask",
)  # fmt: skip


def rules() -> Iterator[tuple[str, str, tuple[str, ...]]]:
    """Yield kind, name and permissions of every rule."""
    both = ("ros_publish", "ros_subscribe")
    for name in TOPICS:
        yield "ros_topic", f"/{name}", both
    for node in NODES:
        yield "ros_topic", f"/{node}/transition_event", both
        yield "ros_parameter", f"/{node}", ("ros_read", "ros_write")
        for service in LIFECYCLE:
            yield "ros_service", f"/{node}/{service}", ("ros_execute",)
        for service in LIFECYCLE[:2]:
            yield "ros_service", f"/{node}/{service}", ("ros_call",)
    for name in SERVICES:
        yield "ros_service", f"/{name}", ("ros_execute", "ros_call")
    for name in ACTIONS:
        yield "ros_action", f"/{name}", ("ros_operate", "ros_request")


def policy() -> str:
    """Return the policy: every rule with the name in full."""
    written = "".join(
        f'    <{kind} qualifier="ALLOW">\n      <attachment>{name}</attachment>\n'
        f"      <permissions>{''.join(f'<{each}/>' for each in permissions)}</permissions>\n    </{kind}>\n"
        for kind, name, permissions in rules()
    )
    return (
        '<profiles xmlns:xi="http://www.w3.org/2001/XInclude">\n  <profile name="navigation">\n'
        f'    <attachment>{SUBJECT}</attachment>\n    <xi:include href="common/node.xml" parse="xml"/>\n{written}'
        "  </profile>\n</profiles>\n"
    )
