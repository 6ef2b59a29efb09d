// Exchanges the server's token for a cookie.
const form = document.querySelector("form");
form.addEventListener("submit", async event => {
  event.preventDefault();
  const token = document.getElementById("token").value.trim();
  const refused = document.getElementById("refused");
  refused.textContent = "";
  try {
    const answer = await fetch("/login", { method: "POST", headers: { Authorization: `Bearer ${token}` } });
    if (answer.ok) location.reload();
    else refused.textContent = "The token is wrong.";
  } catch {
    refused.textContent = "The server does not answer.";
  }
});
