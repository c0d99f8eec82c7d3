// Sends a song to a bailando server and receives the dance while it is made. Plain .NET with
// Newtonsoft.Json, the package com.unity.nuget.newtonsoft-json; C# 7, Unity 2021.3 or newer.
// (WebGL has no HttpClient: there, feed the lines of a UnityWebRequest to Dance.Read.)

using System;
using System.Collections.Generic;
using System.IO;
using System.Linq;
using System.Net.Http;
using System.Net.Http.Headers;
using System.Threading;
using System.Threading.Tasks;
using Newtonsoft.Json.Linq;

namespace Bailando
{
    /// <summary>An answer that is no dance, in the server's words.</summary>
    public sealed class BailandoException : Exception
    {
        public readonly string Kind;

        public BailandoException(string message, string kind) : base(message)
        {
            Kind = kind;
        }
    }

    public sealed class BailandoClient
    {
        private readonly HttpClient http = new HttpClient { Timeout = Timeout.InfiniteTimeSpan };
        private readonly string server;

        public BailandoClient(string server, string key = null)
        {
            this.server = server.TrimEnd('/');
            if (!string.IsNullOrEmpty(key))
                http.DefaultRequestHeaders.Authorization = new AuthenticationHeaderValue("Bearer", key);
        }

        /// <summary>Streams a dance into <paramref name="dance"/>; ends when it is complete.
        /// Options are those of the server. Cancelling stops the server's work as well.</summary>
        public async Task Stream(
            string song, Dance dance, IDictionary<string, string> options, CancellationToken cancel)
        {
            var query = options.Append(new KeyValuePair<string, string>("encoding", "base64"))
                .Append(new KeyValuePair<string, string>("include", "rotations"))
                .Select(o => Uri.EscapeDataString(o.Key) + "=" + Uri.EscapeDataString(o.Value));
            var url = server + "/generate/stream?" + string.Join("&", query);
            using (var file = File.OpenRead(song))
            using (var request = new HttpRequestMessage(HttpMethod.Post, url))
            {
                request.Content = new StreamContent(file);
                request.Content.Headers.ContentType = new MediaTypeHeaderValue("audio/*");
                request.Headers.Accept.ParseAdd("application/x-ndjson");
                var whole = HttpCompletionOption.ResponseHeadersRead;
                using (var answer = await http.SendAsync(request, whole, cancel).ConfigureAwait(false))
                {
                    var body = await answer.Content.ReadAsStreamAsync().ConfigureAwait(false);
                    using (cancel.Register(body.Dispose))
                    using (var lines = new StreamReader(body))
                    {
                        if (!answer.IsSuccessStatusCode)
                            throw Refusal(await lines.ReadToEndAsync().ConfigureAwait(false));
                        string line;
                        while ((line = await lines.ReadLineAsync().ConfigureAwait(false)) != null)
                            dance.Read(line);
                    }
                }
            }
        }

        internal static BailandoException Refusal(string json)
        {
            var refusal = JObject.Parse(json);
            return new BailandoException((string)refusal["error"], (string)refusal["error_type"]);
        }
    }
}
