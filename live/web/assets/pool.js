// The simulator's workers: at most one per core of this machine, made when they are needed.
export class Pool {
  constructor(compiled, address) {
    Object.assign(this, { compiled, address, idle: [], workers: new Set(), waiting: [], answers: new Map(), asked: 0 });
    this.size = Math.max(1, Math.min(navigator.hardwareConcurrency || 2, 16));
  }

  // Returns the answer, or throws the one line of bad input. A new question replaces the waiting questions of the same
  // `kind`.
  ask(question, kind = null, more = []) {
    if (kind) {
      for (const old of this.waiting.filter((one) => one.kind === kind)) old.reject(new Error("another question has come"));
      this.waiting = this.waiting.filter((one) => one.kind !== kind);
    }
    return new Promise((resolve, reject) => {
      const job = { id: ++this.asked, question, kind, more, resolve, reject };
      // A question with a `kind` goes before studies, since a person waits for it at the plane.
      if (kind) this.waiting.unshift(job); else this.waiting.push(job);
      this.next();
    });
  }

  // Returns all answers in the order of the questions. `done` gets the count of answers so far.
  all(questions, done = () => {}) {
    let count = 0;
    return Promise.all(questions.map((question) => this.ask(question).then((answer) => { done(++count, questions.length); return answer; })));
  }

  // Ends all waiting and running studies. A question with a `kind` is not a study.
  end() {
    const ended = new Error("ended");
    for (const job of this.waiting.filter(({ kind }) => !kind)) job.reject(ended);
    this.waiting = this.waiting.filter(({ kind }) => kind);
    for (const [id, job] of this.answers) {
      if (job.kind) continue;
      this.answers.delete(id);
      this.drop(job.worker);
      job.reject(ended);
    }
    this.next();
  }

  drop(worker) {
    worker.terminate();
    this.workers.delete(worker);
    this.idle = this.idle.filter((one) => one !== worker);
  }

  next() {
    if (!this.waiting.length || !this.idle.length && this.workers.size >= this.size) return;
    const worker = this.idle.pop() ?? this.make();
    const job = this.waiting.shift();
    this.answers.set(job.id, { ...job, worker });
    this.compiled.then((compiled) => worker.postMessage({ compiled, id: job.id, question: job.question, more: job.more }), job.reject);
    this.next();
  }

  make() {
    const worker = new Worker(this.address, { type: "module" });
    this.workers.add(worker);
    const finish = (id) => {
      const job = this.answers.get(id);
      this.answers.delete(id);
      return job;
    };
    worker.onmessage = ({ data: { id, answer, failed } }) => {
      if (!this.workers.has(worker)) return;
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
      this.drop(worker);
      this.next();
    };
    return worker;
  }
}
