//! Past calibrations of each arm.

use std::sync::Arc;

use axum::Json;
use axum::extract::State;
use axum::response::{IntoResponse, Response};
use serde::Serialize;

use super::{RequestContext, with_store};
use spherecal_store::history::{self, LIMIT_MM, Past, Trend};

#[derive(Serialize)]
struct ArmHistory {
    robot: String,
    arm: String,
    /// Oldest first.
    runs: Vec<Past>,
    /// Trend of the trusted calibrations; `None` without one.
    trend: Option<Trend>,
}

/// `/api/history`. Without a store the answer is empty and says so.
pub(super) async fn history(State(site): State<Arc<RequestContext>>) -> Response {
    let Some(store) = &site.page.store else {
        return Json(serde_json::json!({ "arms": [], "limit_mm": LIMIT_MM, "stored": false })).into_response();
    };
    match with_store(store, |store| history::read(store, "")).await {
        Ok(past) => {
            let arms: Vec<ArmHistory> = history::by_arm(past)
                .into_iter()
                .map(|runs| ArmHistory {
                    robot: runs.first().map(|p| p.robot.clone()).unwrap_or_default(),
                    arm: runs.first().map(|p| p.arm.clone()).unwrap_or_default(),
                    trend: history::trend(&runs, LIMIT_MM),
                    runs,
                })
                .collect();
            Json(serde_json::json!({ "arms": arms, "limit_mm": LIMIT_MM, "stored": true })).into_response()
        }
        Err(refusal) => refusal,
    }
}
