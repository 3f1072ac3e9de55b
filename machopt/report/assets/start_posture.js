const VIEW = (host => host ? postureView(host, JSON.parse(document.getElementById("data").textContent).view) : null)(document.getElementById("view"));
