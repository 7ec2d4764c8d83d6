// Whom the page talks to: the server that it came from. The page without a server has another file in this place.
import { SocketLink } from "./link.js";

export const link = new SocketLink(new URLSearchParams(location.search).get("token") ?? "");
