// The simulator's workers: as many as this machine has cores, made when they are needed.
export class Pool {
  constructor(compiled, address) {
    Object.assign(this, { compiled, address, idle: [], made: 0, waiting: [], answers: new Map(), asked: 0 });
    this.size = Math.max(1, Math.min(navigator.hardwareConcurrency || 2, 16));
  }

  // The answer; throws the one line of bad input. Of the questions of one `kind` that wait only the last is asked.
  ask(question, kind = null, more = []) {
    if (kind) {
      for (const old of this.waiting.filter((one) => one.kind === kind)) old.reject(new Error("another question has come"));
      this.waiting = this.waiting.filter((one) => one.kind !== kind);
    }
    return new Promise((resolve, reject) => {
      const job = { id: ++this.asked, question, kind, more, resolve, reject };
      // What a person waits for at the plane goes before a study.
      if (kind) this.waiting.unshift(job); else this.waiting.push(job);
      this.next();
    });
  }

  // The answers to all of them, in their order; `done` is told how many there are.
  all(questions, done = () => {}) {
    let count = 0;
    return Promise.all(questions.map((question) => this.ask(question).then((answer) => { done(++count, questions.length); return answer; })));
  }

  // What waits or runs is given up.
  end() {
    for (const { reject } of [...this.waiting, ...this.answers.values()]) reject(new Error("ended"));
    this.waiting = [];
    for (const { worker } of this.answers.values()) { worker.terminate(); this.made--; }
    this.answers.clear();
  }

  next() {
    if (!this.waiting.length || !this.idle.length && this.made >= this.size) return;
    const worker = this.idle.pop() ?? this.make();
    const job = this.waiting.shift();
    this.answers.set(job.id, { ...job, worker });
    this.compiled.then((compiled) => worker.postMessage({ compiled, id: job.id, question: job.question, more: job.more }), job.reject);
    this.next();
  }

  make() {
    this.made++;
    const worker = new Worker(this.address, { type: "module" });
    const finish = (id) => {
      const job = this.answers.get(id);
      this.answers.delete(id);
      return job;
    };
    worker.onmessage = ({ data: { id, answer, failed } }) => {
      const job = finish(id);
      this.idle.push(worker);
      this.next();
      if (failed === undefined) job?.resolve(answer); else job?.reject(new Error(failed));
    };
    worker.onerror = (event) => {
      for (const [id, job] of this.answers) {
        if (job.worker !== worker) continue;
        finish(id).reject(new Error(event.message || "a worker of the simulator does not start"));
      }
      worker.terminate();
      this.made--;
      this.next();
    };
    return worker;
  }
}
