// The page's connection: to the server that sent it. The page without a server replaces this file.
import { SocketLink } from "./link.js";

export const link = new SocketLink(new URLSearchParams(location.search).get("token") ?? "");
