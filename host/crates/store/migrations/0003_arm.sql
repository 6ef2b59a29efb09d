-- Schema 3. Which arm a run calibrated: a store may hold a fleet's.

ALTER TABLE runs ADD COLUMN arm TEXT NOT NULL DEFAULT '';

CREATE INDEX runs_by_arm ON runs (robot, arm, created_utc);
