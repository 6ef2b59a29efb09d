-- Schema 1. Only types and clauses that SQLite and PostgreSQL share.
-- SI units, in the names where they are not obvious; times in µs of the device.

CREATE TABLE runs (
    run          BIGINT PRIMARY KEY,
    created_utc  TEXT NOT NULL,
    seed         BIGINT NOT NULL,
    link         TEXT NOT NULL,
    robot        TEXT NOT NULL,
    robot_json   TEXT NOT NULL,
    tool_json    TEXT NOT NULL,
    config_toml  TEXT NOT NULL,
    plan_json    TEXT NOT NULL,
    program      TEXT NOT NULL,
    state        TEXT NOT NULL
);

-- One row for each time that a program worked on a run: a resumed run has several.
CREATE TABLE sessions (
    run           BIGINT NOT NULL REFERENCES runs (run),
    session       BIGINT NOT NULL,
    started_utc   TEXT NOT NULL,
    firmware      TEXT NOT NULL,
    simulated_us  BIGINT NOT NULL,
    ticks         BIGINT NOT NULL,
    wall_s        DOUBLE PRECISION NOT NULL,
    link_json     TEXT NOT NULL,
    telemetry_json TEXT NOT NULL,
    PRIMARY KEY (run, session)
);

-- The plate's certificate.
CREATE TABLE spheres (
    run      BIGINT NOT NULL REFERENCES runs (run),
    sphere   BIGINT NOT NULL,
    x_m      DOUBLE PRECISION NOT NULL,
    y_m      DOUBLE PRECISION NOT NULL,
    z_m      DOUBLE PRECISION NOT NULL,
    sigma_m  DOUBLE PRECISION NOT NULL,
    PRIMARY KEY (run, sphere)
);

CREATE TABLE poses (
    run        BIGINT NOT NULL REFERENCES runs (run),
    sphere     BIGINT NOT NULL,
    pose       BIGINT NOT NULL,
    position   BIGINT NOT NULL,
    qw         DOUBLE PRECISION NOT NULL,
    qx         DOUBLE PRECISION NOT NULL,
    qy         DOUBLE PRECISION NOT NULL,
    qz         DOUBLE PRECISION NOT NULL,
    elbow_rad  DOUBLE PRECISION,
    rejected   TEXT,
    PRIMARY KEY (run, sphere, pose)
);

CREATE TABLE recordings (
    run           BIGINT NOT NULL REFERENCES runs (run),
    sphere        BIGINT NOT NULL,
    pose          BIGINT NOT NULL,
    position      BIGINT NOT NULL,
    session       BIGINT NOT NULL,
    start_us      BIGINT NOT NULL,
    end_us        BIGINT NOT NULL,
    samples       BIGINT NOT NULL,
    gaps          BIGINT NOT NULL,
    tcp_spread_m  DOUBLE PRECISION NOT NULL,
    force_x_n     DOUBLE PRECISION NOT NULL,
    force_y_n     DOUBLE PRECISION NOT NULL,
    force_z_n     DOUBLE PRECISION NOT NULL,
    PRIMARY KEY (run, sphere, pose)
);

CREATE TABLE recording_joints (
    run          BIGINT NOT NULL,
    sphere       BIGINT NOT NULL,
    pose         BIGINT NOT NULL,
    joint        BIGINT NOT NULL,
    q_mean_rad   DOUBLE PRECISION NOT NULL,
    q_std_rad    DOUBLE PRECISION NOT NULL,
    q_min_rad    DOUBLE PRECISION NOT NULL,
    q_max_rad    DOUBLE PRECISION NOT NULL,
    tau_mean_nm  DOUBLE PRECISION NOT NULL,
    tau_std_nm   DOUBLE PRECISION NOT NULL,
    tau_min_nm   DOUBLE PRECISION NOT NULL,
    tau_max_nm   DOUBLE PRECISION NOT NULL,
    PRIMARY KEY (run, sphere, pose, joint),
    FOREIGN KEY (run, sphere, pose) REFERENCES recordings (run, sphere, pose)
);

CREATE TABLE contacts (
    run              BIGINT NOT NULL REFERENCES runs (run),
    session          BIGINT NOT NULL,
    event            BIGINT NOT NULL,
    sphere           BIGINT NOT NULL,
    time_us          BIGINT NOT NULL,
    force_n          DOUBLE PRECISION NOT NULL,
    peak_n           DOUBLE PRECISION NOT NULL,
    tare_x_n         DOUBLE PRECISION NOT NULL,
    tare_y_n         DOUBLE PRECISION NOT NULL,
    tare_z_n         DOUBLE PRECISION NOT NULL,
    tcp_x_m          DOUBLE PRECISION NOT NULL,
    tcp_y_m          DOUBLE PRECISION NOT NULL,
    tcp_z_m          DOUBLE PRECISION NOT NULL,
    travel_m         DOUBLE PRECISION NOT NULL,
    latency_ticks    BIGINT NOT NULL,
    early_crossings  BIGINT NOT NULL,
    PRIMARY KEY (run, session, event)
);

CREATE TABLE couplings (
    run         BIGINT NOT NULL REFERENCES runs (run),
    session     BIGINT NOT NULL,
    event       BIGINT NOT NULL,
    sphere      BIGINT NOT NULL,
    time_us     BIGINT NOT NULL,
    centre_x_m  DOUBLE PRECISION NOT NULL,
    centre_y_m  DOUBLE PRECISION NOT NULL,
    centre_z_m  DOUBLE PRECISION NOT NULL,
    shift_m     DOUBLE PRECISION NOT NULL,
    test_m      DOUBLE PRECISION NOT NULL,
    PRIMARY KEY (run, session, event)
);

CREATE TABLE phases (
    run      BIGINT NOT NULL REFERENCES runs (run),
    session  BIGINT NOT NULL,
    event    BIGINT NOT NULL,
    phase    TEXT NOT NULL,
    previous TEXT NOT NULL,
    time_us  BIGINT NOT NULL,
    tick     BIGINT NOT NULL,
    PRIMARY KEY (run, session, event)
);

CREATE TABLE faults (
    run      BIGINT NOT NULL REFERENCES runs (run),
    session  BIGINT NOT NULL,
    event    BIGINT NOT NULL,
    fault    TEXT NOT NULL,
    phase    TEXT NOT NULL,
    time_us  BIGINT NOT NULL,
    tick     BIGINT NOT NULL,
    joint    BIGINT NOT NULL,
    value    TEXT NOT NULL,
    bound    TEXT NOT NULL,
    PRIMARY KEY (run, session, event)
);

-- Laser tracker shots: purpose is calibrate, validate, base_1, base_2, tool_5, tool_6 or tool_7.
CREATE TABLE laser_shots (
    run      BIGINT NOT NULL REFERENCES runs (run),
    purpose  TEXT NOT NULL,
    position BIGINT NOT NULL,
    q_json   TEXT NOT NULL,
    x_m      DOUBLE PRECISION NOT NULL,
    y_m      DOUBLE PRECISION NOT NULL,
    z_m      DOUBLE PRECISION NOT NULL,
    PRIMARY KEY (run, purpose, position)
);

-- What was computed from it, as JSON: calibrations, validation, the summary.
CREATE TABLE results (
    run   BIGINT NOT NULL REFERENCES runs (run),
    name  TEXT NOT NULL,
    json  TEXT NOT NULL,
    PRIMARY KEY (run, name)
);
