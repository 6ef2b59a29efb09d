-- Schema 2. Only types and clauses that SQLite and PostgreSQL share.

-- Who greeted the controller: an event is known for good by the number of its
-- host link session (nonce) and its own.
CREATE TABLE greetings (
    run       BIGINT NOT NULL,
    session   BIGINT NOT NULL,
    greeting  BIGINT NOT NULL,
    nonce     BIGINT NOT NULL,
    PRIMARY KEY (run, session, greeting),
    FOREIGN KEY (run, session) REFERENCES sessions (run, session)
);

-- Digests of what must not change in silence: `run` (the robot, configuration,
-- plan and certificate), `laser`, and one `recording SPHERE POSE` each.
CREATE TABLE digests (
    run      BIGINT NOT NULL REFERENCES runs (run),
    subject  TEXT NOT NULL,
    digest   BIGINT NOT NULL,
    PRIMARY KEY (run, subject)
);
