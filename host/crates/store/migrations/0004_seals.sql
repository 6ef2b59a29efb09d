-- Schema 4. Only types and clauses that SQLite and PostgreSQL share.

-- From here on, `digests` has one digest for every row of every other table of a run. Its subject is
-- the table's name and the row's key. The joints of a recording are part of its own digest.

-- A second copy of each run's settings and certificate: a damaged row of `runs` or `spheres` is
-- restored from it.
CREATE TABLE spares (
    run    BIGINT NOT NULL REFERENCES runs (run),
    name   TEXT NOT NULL,
    value  TEXT NOT NULL,
    PRIMARY KEY (run, name)
);
